"""Configurations that controllers of tests run on, and what is read of them besides."""

import json
import re
import socket

import numpy as np

from campaigns.report import CONFIG
from campaigns.running_controller import PATIENCE_S
from micromanip.rt import mailbox as w

SIMULATED = CONFIG / "paper.yaml"
# The program, with the locks of the devices in a folder of the test's own.
LOCKS_ELSEWHERE = (
    "import sys, pathlib, micromanip.bus.device_lock as lock; lock.FOLDER = pathlib.Path(sys.argv[1]); "
    "from micromanip.cli.main import main; main(sys.argv[3:])"
)

# Two daemons may run at a time (pytest -n 2) on two CPUs: none is pinned, each leaves the CPU to others.
SHARED = (
    ("  cpu: 1                  # the loop's own CPU; null leaves it free\n", "  cpu: null\n"),
    ("spin_us: 60 ", "spin_us: 10 "),
)
QUICK = (
    ("lift_s: 0.5", "check_s: null\n  sweep_s: 0.0\n  lift_s: 0.2"),
    ("settle_s: 0.2", "settle_s: 0.1"),
    ("authority_s: 0.5", "authority_s: 0.2"),
)
WAITING = (("arm_on_start: true", "arm_on_start: false"),)

# Overruns can be told from a noisy machine's stalls only with a long period: 3 of these are 15 ms.
SLOW = """\
schema_version: 2
loop: {rate_hz: 200, cpu: null, spin_us: 10, limits: hardware}
start: {lift_s: 0.1, settle_s: 0.0, authority_s: 0.1, ramp_s: 0.2}
faults: {deadline: {share_percent: null}, hold: {timeout_s: 0.2}}
drivers: {cell: {driver: simulated, axes: [x]}}
signals: {strain_x: {driver: cell, max_age_us: null}}
outputs: {voltage_x: {driver: cell, range_V: [-20, 150], slew_V_per_ms: 40, park_V: 0}}
reference: {source: hold, offset_um: 60}
axes:
  x:
    mode: voltage
    centre_um: 66
    setpoint: {range_um: [2, 128]}
    inner: {mode: pid, K_V_per_um: 0.6, Ti_ms: 0.571, Td_ms: 0.167, filter_ms: 0.3}
arm_on_start: true
"""
# The same for who only talks to the host: at this rate a loop that runs for a minute costs hardly any CPU.
LEISURELY = SLOW.replace("limits: hardware", "limits: simulation")


def changed(text, *changes):
    """`text` with each (old, new) replaced; each old must single out one place."""
    for old, new in changes:
        assert text.count(old) == 1, f"{old!r} must single out one place"
        text = text.replace(old, new)
    return text


def simulated(*changes):
    """The tuned configuration, fit to run beside another one."""
    return changed(SIMULATED.read_text(), *SHARED, *changes)


def calm(*changes):
    """The same, but it holds the actuators without machining: no stall of a busy machine disturbs the inner loops."""
    text = simulated(*QUICK, *changes)
    text, references = re.subn(r"(?m)^reference:\n(  .*\n)+", "reference: {source: hold, offset_um: 65}\n", text)
    text, forces = re.subn(r"(?m)^    force: .*\n", "    force: {static_N: 0, tooth_N: 0, noise_N: 0}\n", text)
    text, modes = re.subn("    mode: stage  ", "    mode: strain ", text)
    assert (references, forces, modes) == (1, 1, 3)
    return text


def rows_of(ring):
    """All rows that the ring still holds, oldest first."""
    head, size = int(ring["words"][w.RING_HEAD]), len(ring["rows"])
    return ring["rows"][np.arange(max(0, head - size + 1), head) % size].copy()


class Talk:
    """A raw connection to a control socket."""

    def __init__(self, path):
        self.socket = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        self.socket.connect(str(path))  # waits where the queue is full
        self.socket.settimeout(PATIENCE_S)
        self.file = self.socket.makefile("rb")

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.file.close()
        self.socket.close()

    def send(self, line):
        self.socket.sendall(line)

    def hear(self):
        """The next answer; None at the end of the connection."""
        line = self.file.readline()
        return json.loads(line) if line else None

    def ask(self, line):
        self.send(line + b"\n")
        return self.hear()
