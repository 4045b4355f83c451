"""The driver `ethercat` without a loop, and slaves in a thread at the far end of a veth pair, whose wire may be bad."""

import select
import threading
import time

import numpy as np
from micromanip_drivers.ethercat.driver import Ethercat
from micromanip_drivers.ethercat.options import EthercatOptions
from micromanip_drivers.ethercat.records import CONTEXT

from micromanip.bus.ethercat.registers import NOP
from micromanip.bus.safe_state import SWITCH, VOLTAGE, SafeOutput
from micromanip.emulation.ethercat.line import Line
from micromanip.emulation.ethercat.terminal import INPUTS, OUTPUTS, terminal_of
from tests.drivers.called import Called
from tests.emulation.ethercat.wire import raw, until

PERIOD_NS = 100_000
SILENT_CYCLES, STILL_CYCLES = 20, 150
AMPLIFIER = {
    "vendor": 0x4D4D,
    "product": 0x10,
    "serial": 7,
    "settings": {"range": {"index": 0x8000, "subindex": 1, "type": "uint16", "value": 513}},
    "outputs": {
        "voltages": {
            "pdo": 0x1600,
            "fields": {
                "voltage": {"index": 0x7000, "subindex": 1, "type": "int32", "scale": 1e-4, "range": (-20, 150)},
                "feed_hold": {"index": 0x7001, "subindex": 1, "type": "uint8", "switch": True, "safe": 1},
            },
        }
    },
    "inputs": {"state": {"pdo": 0x1A00, "fields": {"ok": {"index": 0x6000, "subindex": 1, "type": "uint8"}}}},
}
PINS_OUT = {
    "vendor": 0x4D4D,
    "product": 0x30,
    "outputs": {
        f"channel_{k}": {
            "pdo": 0x1600 + k,
            "fields": {name: {"index": 0x7000 + 16 * k, "subindex": 1, "type": "bool"} | keys},
        }
        for k, (name, keys) in enumerate(
            [
                ("enable", {"switch": True}),
                ("unused", {"spare": True, "scale": -1, "offset": 1, "safe": 1}),
                ("feed_hold_line", {"switch": True, "scale": -1, "offset": 1, "safe": 1}),
                ("lamp", {"switch": True}),
            ]
        )
    },
}
"""Four lines in half a byte; the terminal has no processor, and no mailbox."""
PINS_IN = {
    "vendor": 0x4D4D,
    "product": 0x31,
    "inputs": {
        f"channel_{k}": {
            "pdo": 0x1A00 + k,
            "fields": {f"line_{k}": {"index": 0x6000 + 16 * k, "subindex": 1, "type": "bool"}},
        }
        for k in range(8)
    },
}
ANALOGUE = {
    "vendor": 0x4D4D,
    "product": 0x32,
    "inputs": {
        "channel": {
            "pdo": 0x1A00,
            "fields": {
                "underrange": {"index": 0x6000, "subindex": 1, "type": "bool"},
                "overrange": {"index": 0x6000, "subindex": 2, "type": "bool"},
                "limit_1": {"index": 0x6000, "subindex": 3, "type": "bit2"},
                "limit_2": {"index": 0x6000, "subindex": 5, "type": "bit2", "spare": True},
                "error": {"index": 0x6000, "subindex": 7, "type": "bool"},
                "gap": {"index": 0, "type": "bit6"},
                "temperature": {"index": 0x6000, "subindex": 17, "type": "int16", "scale": 0.1},
            },
        }
    },
}
"""Status bits before a value that so begins within a byte."""
GAUGE = {
    "vendor": 0x4D4D,
    "product": 0x20,
    "inputs": {
        "tracker": {
            "pdo": 0x1A01,
            "counter": "count",
            "rate_hz": 1000,
            "latency_us": 1000,
            "fields": {
                "count": {"index": 0x6010, "subindex": 1, "type": "uint8"},
                "deviation": {"index": 0x6010, "subindex": 2, "type": "int32", "scale": 1e-3},
            },
        },
        "strain": {
            "pdo": 0x1A00,
            "fields": {"strain": {"index": 0x6000, "subindex": 1, "type": "int32", "scale": 1e-4}},
        },
    },
}


def options(interface="none0", **changes):
    """An amplifier, and behind it a gauge that passes a tracker on."""
    keys = {
        "interface": interface,
        "simulated": True,
        "silence_ms": 2,
        "watchdog": {"ms": 1000, "rest_ms": 5, "after_power_on": "rest"},
        "cyclic_safe": True,
        "terminals": {"amplifier": AMPLIFIER, "gauge": GAUGE},
    }
    return EthercatOptions.model_validate(keys | changes)


class Bench(Called):
    """A driver, and its slaves; `meddle` gets each cyclic frame on its way back and gives those that arrive.

    `far_ends` are those of the pair by which a ring comes back.
    """

    def __init__(self, ends, step_V=1e3, slaves=None, far_ends=None, **changes):
        pairs = [ends] if far_ends is None else [ends, far_ends]
        if far_ends is not None:
            changes |= {"return_interface": far_ends[0]}
        self.options = options(ends[0], **changes)
        voltage = SafeOutput(VOLTAGE, 0.0, -20.0, 150.0, step_V / (1e-9 * PERIOD_NS))
        super().__init__(Ethercat(self.options, PERIOD_NS), [voltage, SafeOutput(SWITCH, 1.0, 0.0, 1.0)])
        c = self.context.view(CONTEXT)[0]
        c["gate"]["still_ns"] = STILL_CYCLES * PERIOD_NS  # in cycles, whatever the slaves' own watchdog may be
        slaves = self.options.terminals if slaves is None else slaves
        self.line = Line([terminal_of(name, keys) for name, keys in slaves.items()], is_ring=len(pairs) > 1)
        self.meddle = lambda frame: [frame]
        self._far, self._done, self.lock = [raw(there) for _, there in pairs], threading.Event(), threading.Lock()
        self.came = 0
        self.by_the_clock = False  # a machine that stalls would be a lost link
        self._thread = threading.Thread(target=self._play)
        self._thread.start()
        self.now_ns = time.monotonic_ns()

    def _play(self):
        while not self._done.is_set():
            for far in select.select(self._far, [], [], 0.02)[0]:
                frame, end = far.recv(2048), self._far.index(far)
                with self.lock:
                    back, out = self.line.passed(frame, time.monotonic_ns(), end), self.line.ways[end].out
                    is_cyclic = frame[16] == NOP
                    for each in self.meddle(back) if is_cyclic and back else filter(None, [back]):
                        self._far[out].send(each)
                    self.came += is_cyclic

    def close(self):
        super().close()
        self._done.set()
        self._thread.join()
        for far in self._far:
            far.close()

    def __enter__(self):
        return self

    @property
    def c(self):
        return self.context.view(CONTEXT)[0]

    def exchange(self, *outputs):
        """One cycle of the loop; what it sends has been through the slaves before this returns."""
        self.outputs[: len(outputs)] = outputs
        periods = 1
        if self.by_the_clock:
            periods += max(0, (time.monotonic_ns() - self.now_ns) // PERIOD_NS)
        self.now_ns += periods * PERIOD_NS + int(self.c["lock"]["step_ns"][0])
        sent, came = int(self.c["gate"]["sent_count"]), self.came
        code = self.exchange_at(self.now_ns, periods)
        if int(self.c["gate"]["sent_count"]) > sent:
            assert until(lambda: self.came >= came + len(self._far))
        return code

    def until_code(self, code, *outputs):
        """Cycles until that is what they return."""
        assert until(lambda: self.exchange(*outputs) == code)
        return self

    def follow(self):
        """Cycles at rest until the outputs follow."""
        return self.until_code(0, 0.0, 1.0)

    @property
    def voltage(self):
        """What the amplifier was given last."""
        return self.line.applications[0].memory[OUTPUTS : OUTPUTS + 4].view(np.int32)[0] * 1e-4

    def measure(self, strain, count, deviation):
        """Let the gauge and its tracker say that."""
        memory = self.line.applications[1].memory
        memory[INPUTS] = count
        memory[INPUTS + 1 : INPUTS + 5].view(np.uint8)[:] = np.frombuffer(np.int32(round(deviation * 1e3)), np.uint8)
        memory[INPUTS + 5 : INPUTS + 9].view(np.uint8)[:] = np.frombuffer(np.int32(round(strain * 1e4)), np.uint8)
