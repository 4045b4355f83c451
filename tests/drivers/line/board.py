"""A board with strains and voltages: frames with sync bytes, length, kind, counter and CRC-8, by hand."""

import struct

from .line_peer import LinePeer

AXES = ("x", "y", "z")
BAUD, BITS = 1_000_000, 10
RECEIVED, SENT = 20, 13
"""Bytes of its two frames: sync 2, length, kind, counter 2, then status and 3 x int32, or 3 x int16; and the CRC."""

FRAMING = {
    "silence_ms": 200,
    "watchdog": {"ms": 10, "rest_ms": 5, "after_power_on": "rest"},
    "binary": {
        "sync": "aa 55",
        "length": {"at": 2, "type": "uint8", "plus": 5},
        "kind": {"at": 3, "type": "uint8"},
        "crc": {"name": "crc8.smbus", "first": 2},
        "identity": {
            "request": "aa 55 00 01",
            "kind": 0x81,
            "numbers": {"serial_number": {"at": 4, "type": "uint32", "byte_order": "little", "value": 1234}},
        },
        "receive": {
            "strains": {
                "kind": 0x10,
                "rate_hz": 1000,
                "counter": {"at": 4, "type": "uint16", "byte_order": "little"},
                "status": {"at": 6, "type": "uint8", "good": [0]},
                "fields": {
                    f"strain_{axis}": {"at": 7 + 4 * i, "type": "int32", "byte_order": "little", "scale": 1e-4}
                    for i, axis in enumerate(AXES)
                },
            }
        },
        "send": {
            "voltages": {
                "kind": 0x20,
                "rate_hz": 1000,
                "cyclic_safe": True,
                "counter": {"at": 4, "type": "uint16", "byte_order": "little"},
                "fields": {
                    f"voltage_{axis}": {
                        "at": 6 + 2 * i,
                        "type": "int16",
                        "byte_order": "little",
                        "scale": 0.005,
                        "range": [-20.0, 150.0],
                    }
                    for i, axis in enumerate(AXES)
                },
            }
        },
    },
}


def crc8(data):
    """CRC-8 with polynomial 0x07, bit by bit."""
    remainder = 0
    for byte in data:
        remainder ^= byte
        for _ in range(8):
            remainder = (remainder << 1 ^ 0x07) & 0xFF if remainder & 0x80 else remainder << 1
    return remainder


def frame(kind, payload):
    """A frame of the board."""
    covered = bytes((len(payload), kind)) + payload
    return b"\xaa\x55" + covered + bytes((crc8(covered),))


class Board(LinePeer):
    """Strains 1000 times a second; voltages whenever they come."""

    framing = FRAMING

    def power_on(self):
        super().power_on()
        self.count, self.buffer, self.status = 0, b"", 0

    def speak(self):
        steps = [round(self.inputs.get(f"strain_{axis}", 0.0) / 1e-4) for axis in AXES]
        self.wire.write(frame(0x10, struct.pack("<HB3i", self.count & 0xFFFF, self.status, *steps)))
        self.count += 1
        self.said += 1

    def skip(self, count):
        with self.lock:
            self.count += count

    def take(self, data):
        self.buffer += data
        while (at := self.buffer.find(b"\xaa\x55")) >= 0 and len(self.buffer) >= at + 3:
            length = self.buffer[at + 2] + 5
            if len(self.buffer) < at + length:
                return
            unit, self.buffer = self.buffer[at : at + length], self.buffer[at + length :]
            if crc8(unit[2:-1]) == unit[-1] and not self.silent:
                self.understand(unit)

    def understand(self, unit):
        self.heard += 1
        if unit[3] == 0x01:
            self.wire.write(frame(0x81, struct.pack("<I", 1234)))
        if unit[3] == 0x20:
            self.units.append(unit[:4] + unit[6:-1])  # without what differs from one to the next: counter and CRC
            steps = struct.unpack_from("<3h", unit, 6)
            self.written.append({f"voltage_{axis}": step * 0.005 for axis, step in zip(AXES, steps, strict=True)})

    def busy_s(self):
        with self.lock:
            said, heard, self.said, self.heard = self.said, self.heard, 0, 0
        byte_s = BITS / BAUD
        name = self.wire.path.name
        return {f"{name} in": said * RECEIVED * byte_s, f"{name} out": heard * SENT * byte_s}
