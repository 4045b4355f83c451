"""The simulated cell with all its lines and the limits of real hardware, and a fault at a set time in it."""

import tempfile
from pathlib import Path

import numpy as np

from campaigns.report import CONFIG
from micromanip.rt.faults import EVENTS
from micromanip.rt.states import ARM, ARMING, HOLDING, RAMPING, READY, TRACKING
from micromanip.settings.check import prepare
from micromanip.virtual.cell import VirtualCell

PAPER = CONFIG / "paper.yaml"
AT_S = 2.0
"""When the fault comes: the cell tracks by then."""
SWITCHES = """\
switches:
  amplifier_enable: {driver: cell}
  feed_hold: {driver: cell}
  heartbeat: {driver: cell}
"""
LINES = "".join(
    f"  {name}: {{driver: cell}}\n"
    for name in (
        *("enable", "interlock", "retracted"),
        *(f"{name}_{axis}" for name in ("amplifier_ok", "temperature_ok") for axis in "xyz"),
    )
)
START = (
    "  lift_s: 0.5\n  settle_s: 0.2\n  authority_s: 0.5\n  ramp_s: 0.5\n",
    "  enable_s: 0.02\n  check_s: 0.05\n  lift_s: 0.2\n  sweep_s: 0.3\n  settle_s: 0.1\n  authority_s: 0.2\n"
    "  ramp_s: 0.5\n",
)


def text(faults=(), force="{start_s: 1.6, static_N: 80.0, tooth_N: 40.0, tooth_Hz: 200.0, noise_N: 5.0}", limits=""):
    """Configuration: `faults` are the driver's, `limits` the section of that name."""
    source = PAPER.read_text()
    scheduled = "".join(f"      - {{at_s: {AT_S}, {fault}}}\n" for fault in faults)
    injected = "    faults:\n" + scheduled if faults else ""
    for old, new in (
        ("limits: simulation", "limits: hardware"),
        ("arm_on_start: true", "arm_on_start: false"),
        START,
        ("    seed: 1\n", "    seed: 1\n    lines: {retract_s: 0.3, heartbeat_ms: 50}\n" + injected),
        ("{start_s: 5.0, static_N: 80.0, tooth_N: 40.0, tooth_Hz: 200.0, noise_N: 5.0}", force),
        ("outputs:\n", LINES + "\noutputs:\n"),
        ("reference:\n", SWITCHES + (f"faults:\n{limits}" if limits else "") + "\nreference:\n"),
    ):
        assert source.count(old) == 1, old
        source = source.replace(old, new)
    return source


class Protected:
    """The cell, armed, and all rows of its run."""

    def __init__(self, *faults, **options):
        with tempfile.TemporaryDirectory() as folder:
            file = Path(folder) / "cell.yaml"
            file.write_text(text(faults, **options))
            self.prepared = prepare(file)
        self.cell = VirtualCell(self.prepared.parameters, self.prepared.wiring)
        self.s, self.p = self.cell.state[0], self.cell.parameters[0]
        rows = [self.cell.run(0.01), self.cell.run(AT_S - 0.01 - 0.0001, command=ARM)]
        assert self.s["state"] == TRACKING, (self.s["state"], self.events)
        assert self.s["events"] == 0
        self.before = np.concatenate(rows)

    def run(self, seconds):
        """Rows from the fault on; the voltages of every row are inside range and slew limit."""
        rows = self.cell.run(seconds)
        every = np.concatenate([self.before, rows])
        self.before = every
        voltage = every["axis"]["voltage_V"]
        assert np.isfinite(voltage).all()
        assert (voltage >= -20.0).all()
        assert (voltage <= 150.0).all()
        assert (np.abs(np.diff(voltage, axis=0)) <= 4.0 + 1e-9).all()
        moving = np.isin(every["state"], (ARMING, TRACKING, HOLDING, RAMPING))
        # at rest the outputs are at park, 43 cycles of slewing after a cut at the latest
        settled = ~moving & (np.convolve(moving, np.ones(44), "full")[: len(moving)] == 0)
        assert (voltage[settled] == 0.0).all()
        return rows

    @property
    def events(self):
        """(cycles after the fault came, code, axis, value, limit), in order."""
        first = round(AT_S * 1e4)
        assert self.s["events"] <= EVENTS
        return [
            (int(e["cycle"]) - first, int(e["code"]), int(e["axis"]), float(e["value"]), float(e["limit"]))
            for e in self.s["event"][: self.s["events"]]
        ]


def course(rows):
    """States in the order in which they were entered, and the row at which each was."""
    states = rows["state"]
    changes = np.flatnonzero(np.diff(states)) + 1
    return [(int(states[0]), 0)] + [(int(states[k]), int(k)) for k in changes]


def states(rows):
    return [state for state, _ in course(rows)]


__all__ = ["AT_S", "READY", "Protected", "course", "states", "text"]
