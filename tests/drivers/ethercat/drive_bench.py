"""A drive behind the driver `ethercat` without a loop: `bench.py` with a single terminal."""

import numpy as np

from micromanip.emulation.ethercat.terminal import OUTPUTS

from .bench import Bench

SCALE = 1e-4
DRIVE = {
    "vendor": 0x4D4D,
    "product": 0x30,
    "drive": {
        "mode": "csp",
        "enable": "amplifier_enable",
        "ok": "amplifier_ok",
        "reset": "amplifier_reset",
        "enable_ms": 100,
        "stop_ms": 50,
        "take_up_V_per_s": 1e4,  # 1 V in a cycle
        "codes": {"quick_stop": 2, "fault_reaction": 2, "connection_lost": 3},
    },
    "outputs": {
        "commands": {
            "pdo": 0x1600,
            "fields": {
                "controlword": {"index": 0x6040, "type": "uint16"},
                "mode": {"index": 0x6060, "type": "int8"},
                "voltage": {"index": 0x607A, "type": "int32", "scale": SCALE, "range": (-20, 150)},
            },
        }
    },
    "inputs": {
        "answers": {
            "pdo": 0x1A00,
            "fields": {
                "statusword": {"index": 0x6041, "type": "uint16"},
                "mode_shown": {"index": 0x6061, "type": "int8"},
                "position": {"index": 0x6064, "type": "int32", "scale": SCALE},
                "error_code": {"index": 0x603F, "type": "uint16"},
            },
        }
    },
}


def drive(**changes):
    """The terminal with other keys of its drive."""
    return DRIVE | {"drive": DRIVE["drive"] | changes}


class DriveBench(Bench):
    """Outputs are the target (V), the permission and the reset."""

    def __init__(self, ends, keys=DRIVE, rest_V=0.0, **changes):
        super().__init__(ends, step_V=5.0, terminals={"stage": keys}, **changes)
        there = self.line.drives[0]
        there["rest"] = there["out"] = there["fell_from"] = there["position"] = rest_V / SCALE
        self.word_seen = []
        """Controlwords, one for each that is another than the one before."""

    def exchange(self, *outputs):
        code = super().exchange(*outputs)
        memory = self.line.applications[0].memory
        word = int(memory[OUTPUTS : OUTPUTS + 2].view(np.uint16)[0])
        if self.word_seen[-1:] != [word]:
            self.word_seen.append(word)
        return code

    def follow(self):
        return self.until_code(0, 0.0, 0.0, 0.0)

    @property
    def out_V(self):
        """What the drive puts out."""
        return float(self.line.drives[0]["out"]) * SCALE

    @property
    def ok(self):
        return float(self.sample("amplifier_ok")["value"])

    def until(self, true, *outputs):
        """Cycles until `true()`; what the drive put out in each."""
        put_out = []
        for _ in range(30_000):
            self.exchange(*outputs)
            put_out.append(self.out_V)
            if true():
                return put_out
        raise AssertionError(f"drive {self.line.drives[0]['state']:#x}, {self.c['drive'][0]}")

    def enable(self, wanted_V=0.0):
        """Permitted, and enabled; what it put out meanwhile."""
        self.until(lambda: self.ok == 1.0, wanted_V, 0.0, 0.0)
        put_out = self.until(lambda: self.c["drive"][0]["enabled"], wanted_V, 1.0, 0.0)
        return put_out + self.until(lambda: self.ok == 1.0, wanted_V, 1.0, 0.0)
