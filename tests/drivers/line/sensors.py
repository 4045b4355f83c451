"""Devices that send samples by themselves: a capacitive sensor over TCP, a laser tracker over UDP."""

import struct
import time
import zlib

from .line_peer import LinePeer

AXES = ("x", "y", "z")
SENSOR = {
    "silence_ms": 200,
    "stream": {
        "magic": "4d 45 41 53",
        "header_bytes": 32,
        "identity": {"serial_number": {"at": 8, "type": "int32", "byte_order": "little", "value": 4711}},
        "status": {"at": 20, "type": "uint32", "byte_order": "little", "good": [0]},
        "blocks": {"at": 24, "type": "uint16", "byte_order": "little", "most": 8},
        "counter": {"at": 28, "type": "uint32", "byte_order": "little", "counts": "samples"},
        "rate_hz": 2000,
        "block_bytes": 12,
        "fields": {
            f"strain_{axis}": {"at": 4 * i, "type": "int32", "byte_order": "little", "scale": 1e-5}
            for i, axis in enumerate(AXES)
        },
    },
}
TRACKER = {
    "silence_ms": 200,
    "stream": {
        "magic": "4c 54",
        "header_bytes": 16,
        "counter": {"at": 4, "type": "uint32", "byte_order": "big", "counts": "packets"},
        "time": {"at": 8, "type": "uint64", "byte_order": "big", "unit_s": 1e-6},
        "rate_hz": 1000,
        "block_bytes": 24,
        "crc": {"name": "crc32.iso_hdlc", "byte_order": "big"},
        "fields": {
            f"stage_{axis}": {"at": 8 * i, "type": "float64", "byte_order": "big", "scale": 1000.0}
            for i, axis in enumerate(AXES)
        },
    },
}


class CapacitiveSensor(LinePeer):
    """Two samples a packet, 1000 packets a second: header and little-endian counts of 10 pm."""

    framing = SENSOR
    blocks = 2

    def power_on(self):
        super().power_on()
        self.count, self.serial_number, self.status = 0, 4711, 0

    def skip(self, count):
        with self.lock:
            self.count += count

    def packet(self, count, *blocks):
        channels = 0x15
        header = struct.pack(
            "<4siiQIHHI", b"MEAS", 1, self.serial_number, channels, self.status, len(blocks), 12, count & 0xFFFFFFFF
        )
        return header + b"".join(struct.pack("<3i", *block) for block in blocks)

    def speak(self):
        block = [round(self.inputs.get(f"strain_{axis}", 0.0) / 1e-5) for axis in AXES]
        self.wire.write(self.packet(self.count, *[block] * self.blocks))
        self.count += self.blocks
        self.said += 1

    def busy_s(self):
        with self.lock:
            said, self.said = self.said, 0
        return {"link 127.0.0.1 in": said * 8 * (38 + 52 + 32 + 12 * self.blocks + 84) / 100e6}


class LaserTracker(LinePeer):
    """A datagram a sample, with the tracker's own time in us."""

    framing = TRACKER

    def power_on(self):
        super().power_on()
        self.count, self.born_ns = 0, time.monotonic_ns()

    def skip(self, count):
        with self.lock:
            self.count += count

    def datagram(self, count, time_us, *stages_mm):
        body = struct.pack(">2sHIQ3d", b"LT", 1, count & 0xFFFFFFFF, time_us, *stages_mm)
        return body + zlib.crc32(body).to_bytes(4, "big")

    def speak(self):
        stages_mm = [self.inputs.get(f"stage_{axis}", 0.0) / 1000.0 for axis in AXES]
        self.wire.write(self.datagram(self.count, (time.monotonic_ns() - self.born_ns) // 1000, *stages_mm))
        self.count += 1
        self.said += 1

    def busy_s(self):
        with self.lock:
            said, self.said = self.said, 0
        return {"link 127.0.0.1 in": said * 8 * (38 + 28 + 44) / 100e6}
