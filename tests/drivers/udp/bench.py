"""The driver `udp` without a loop, and a device that says what a test wants: real sockets, given deadlines."""

import socket
import struct
import time
import zlib

from micromanip_drivers.udp.driver import Udp
from micromanip_drivers.udp.options import UdpOptions
from micromanip_drivers.udp.records import CONTEXT

from micromanip.bus.safe_state import SWITCH, VOLTAGE, SafeOutput

from ..called import Called

PERIOD_NS = 100_000
SILENT_CYCLES, STILL_CYCLES, PATIENT_CYCLES = 20, 160, 5
ANSWER = struct.Struct("<2sHIBifBiH")
COMMAND = struct.Struct("<2sHiB")


def options(port, **changes):
    """A gauge, a stage, a tracker at a rate of its own; a voltage and a switch."""
    number = {"byte_order": "little"}
    keys = {
        "host": "127.0.0.1",
        "port": port,
        "simulated": True,
        "silence_ms": 2,
        "watchdog": {"ms": 10, "rest_ms": 5, "after_power_on": "rest"},
        "crc": {"name": "crc32.iso_hdlc"},
        "receive": {
            "head": "a5 10",
            "counter": {"at": 2, "type": "uint16", **number},
            "clock": {"at": 4, "type": "uint32", "unit_us": 1, **number},
            "acknowledges": {"at": 22, "type": "uint16", **number},
            "status": {"at": 8, "type": "uint8", "good": [0, 3]},
            "fields": {
                "strain": {"at": 9, "type": "int32", "scale": 1e-4, **number},
                "stage": {"at": 13, "type": "float32", **number},
            },
            "slow": {
                "tracker": {
                    "rate_hz": 1000,
                    "counter": {"at": 17, "type": "uint8"},
                    "latency_us": 1000,
                    "fields": {"deviation": {"at": 18, "type": "int32", "scale": 1e-3, **number}},
                }
            },
        },
        "send": {
            "head": "a5 20",
            "counter": {"at": 2, "type": "uint16", **number},
            "cyclic_safe": True,
            "fields": {
                "voltage": {"at": 4, "type": "int32", "scale": 1e-4, "range": (-20, 150), **number},
                "feed_hold": {"at": 8, "type": "uint8", "switch": True, "safe": 1},
            },
        },
    }
    return UdpOptions.model_validate(keys | changes)


def sealed(data):
    """With its CRC-32."""
    return data + struct.pack("<I", zlib.crc32(data))


class Bench(Called):
    """A driver that is open, and its device."""

    def __init__(self, step_V=1e3, **changes):
        """`step_V` is what two voltages that the device gets one after the other may differ by."""
        self.device = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.device.bind(("127.0.0.1", 0))
        self.device.settimeout(1)
        voltage = SafeOutput(VOLTAGE, 0.0, -20.0, 150.0, step_V / (1e-9 * PERIOD_NS))
        driver = Udp(options(self.device.getsockname()[1], **changes), PERIOD_NS)
        super().__init__(driver, [voltage, SafeOutput(SWITCH, 1.0, 0.0, 1.0)])
        self.count, self.tracked, self.acted_on = 0, 0, 65535

    def open(self):
        super().open()
        self.now_ns = time.monotonic_ns()
        return self

    def close(self):
        super().close()
        self.device.close()

    @property
    def c(self):
        return self.context.view(CONTEXT)[0]

    def exchange(self, *outputs, periods=1):
        """One exchange of the loop, `periods` after the one before."""
        self.outputs[: len(outputs)] = outputs
        self.now_ns += periods * PERIOD_NS  # not by the clock: a machine that stalls would be a lost link
        return self.exchange_at(self.now_ns, periods)

    def commands(self):
        """What has come at the device since the last call, which acts on it: (voltage, feed_hold) each."""
        found = self.arrived()
        self.acted_on = found[-1][0] if found else self.acted_on
        return [command[1:] for command in found]

    def arrived(self):
        """What has come since the last call: (count, voltage, feed_hold) each. The device does not act on it yet."""
        self.device.setblocking(False)
        found = []
        while True:
            try:
                data, self.controller = self.device.recvfrom(2048)
            except BlockingIOError:
                return found
            assert data == sealed(data[:-4])
            head, count, voltage, hold = COMMAND.unpack(data[:-4])
            assert head == b"\xa5\x20"
            found.append((count, voltage * 1e-4, hold))

    def datagram(self, strain=1.0, stage=2.0, deviation=3.0, status=0, count=None, stamp=None):
        """An answer; counted on, unless `count` says otherwise."""
        self.count = (self.count + 1) % 65536 if count is None else count
        stamp = time.monotonic_ns() // 1000 if stamp is None else stamp
        numbers = round(strain * 1e4), stage, self.tracked % 256, round(deviation * 1e3), self.acted_on
        return sealed(ANSWER.pack(b"\xa5\x10", self.count, stamp % 2**32, status, *numbers))

    def say(self, data=None, **values):
        """Let the device send an answer, or whatever else."""
        self.commands()
        self.device.sendto(self.datagram(**values) if data is None else data, self.controller)

    def follow(self, *outputs):
        """Answer until the outputs follow the loop."""
        codes = [self.exchange(0.0, 0.0)]
        for _ in range(4):
            self.say()
            codes.append(self.exchange(0.0, 0.0))
        assert codes[-1] == 0, codes
        return self
