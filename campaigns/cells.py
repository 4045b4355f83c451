"""Cells of the watched bench, each on another bus: two axes at rest, slow enough that a jump of a few volts shows."""

import math
import os
import re
from collections.abc import Callable
from dataclasses import dataclass
from random import Random

import yaml

from .fault_cells import CONFIG, assembled
from .oracle import Bounds
from .played.amplifier import Habits
from .played.can_node import CanNode
from .played.canopen_nodes import CanOpenNodes
from .played.datagrams import Datagrams
from .played.lines import Board, CommandValue, Gcs
from .played.modbus import RtuUnits, TcpUnits
from .played.port import DatagramPort, TcpPort, Terminal
from .played.terminals import Terminals, VethPort

KEEPS = "watchdog: {ms: null, after_power_on: last}"
_SILENT_SHARE = 0.1
"""How often nothing is said of a device without a watchdog; of another it would be a lie."""
_NAMES = {"name": "piezo", "inputs": "", "outputs": "", "way": "", "database": CONFIG / "can" / "manipulator.dbc"}
_NAMES |= {"sensor": CONFIG / "can" / "sensor.eds", "amplifier": CONFIG / "can" / "amplifier.eds"}


@dataclass(frozen=True)
class Cell:
    """The cell on one bus; `names` are filled into the file `driver`, `port` takes amplifier and folder."""

    driver: str
    port: Callable
    period_ms: float
    """Of the task that writes the outputs."""
    fine_V: float
    device_V: tuple = (-20.0, 120.0)
    """What the device itself can do."""
    least_boot_ms: float = 400.0
    """A device that is there again sooner, and has no connection that breaks, can't be told from one that stayed."""
    names: tuple = ()
    pauses: bool = True
    """Whether its driver has a key for a pause after opening."""
    hears_by_reads: bool = False
    """Nothing but its readings tells that it hears: without them it can't be written to."""
    guarded: bool = False
    """Its driver takes no device but one whose watchdog leads to rest."""
    blind: bool = False
    """Nothing tells that a value was lost on its way, or refused: so it must come up at rest, and refuses none."""

    def text(self, place, watchdog=KEEPS, settle_ms=0.0):
        """Its configuration, its device at `place`: a port, or a path."""
        names = _NAMES | dict(self.names) | {"place": place, "channel": place}
        names["way"] = names["way"].replace("PLACE", str(place))
        text = assembled("watched", self.driver, **names)
        if settle_ms:
            text = re.sub(rf"(port: {place}|baud: 1000000)}}", rf"\1, settle_ms: {settle_ms}}}", text)
        at = "    " if watchdog.startswith("without") else r"\1"  # of the driver, or of one of its nodes
        return re.sub(r"(?m)^( *)watchdog: .*$", at + watchdog, text)

    def habits(self, seed, number):
        """What the device of a group of interleavings does by itself, and what its configuration says of that."""
        draw = Random(f"{seed}/{self.driver}/{self.names}/{number}")
        guarded = draw.random() < 0.6 or self.guarded
        habits = Habits(
            watchdog_ms=draw.choice((150.0, 300.0, 1000.0)) if guarded else None,
            rest_ms=draw.choice((0.0, 0.0, 50.0, 250.0)) if guarded else 0.0,
            latches=guarded and draw.random() < 0.3,
            after_power_on="rest"
            if self.blind or self.guarded
            else draw.choice((*["rest"] * 3, "last", "unknown")[not guarded :]),
            reads_back=draw.random() < 0.5,
            opening_ms=draw.choice((0.0, 0.0, 300.0, 1500.0)) if self.pauses else 0.0,
            boot_ms=max(self.least_boot_ms, draw.choice((0.0, 20.0, 500.0, 1500.0))),
        )
        ms = "null" if habits.watchdog_ms is None else habits.watchdog_ms
        said = f"watchdog: {{ms: {ms}, rest_ms: {habits.rest_ms}, latches: {str(habits.latches).lower()}, "
        said += f"after_power_on: {habits.after_power_on}}}"
        if draw.random() < _SILENT_SHARE and not guarded:
            said = "without_watchdog: true"
        elif not guarded:
            said += "\n    without_watchdog: true"
        return habits, said, habits.opening_ms + 500.0 if habits.opening_ms else 0.0

    def bounds(self, text, changes):
        """What the outputs may do, read from a configuration, after each `set` of `changes`; None if it is not valid.

        With a reader of our own.
        """
        try:
            outputs = yaml.safe_load(text)["outputs"]
            for key, value in changes.items():
                section, _, rest = key.partition(".")
                if section == "outputs":
                    name, _, what = rest.partition(".")
                    outputs[name][what] = value
            return {name: self._bounds(entry) for name, entry in outputs.items()}
        except (ValueError, TypeError, KeyError, yaml.YAMLError):
            return None

    def _bounds(self, entry):
        low_V, high_V = map(float, entry["range_V"])
        slew, rest_V = float(entry["slew_V_per_ms"]), float(entry["park_V"])
        device_V = self.device_V
        if not (device_V[0] <= low_V <= rest_V <= high_V <= device_V[1] and low_V < high_V and 0.0 < slew < math.inf):
            raise ValueError(entry)
        return Bounds(low_V, high_V, slew * self.period_ms, rest_V, self.fine_V)


def _tcp(converse):
    return lambda amplifier, folder: TcpPort(amplifier, converse)


def _serial(converse):
    return lambda amplifier, folder: Terminal(amplifier, converse, folder / "tty")


_UNITS = (("inputs", "gauge."), ("outputs", "amplifier."))
CELLS = {
    "gcs": Cell("gcs", _tcp(Gcs), 10.0, 2e-3, least_boot_ms=0.0),
    "modbus": Cell(
        "units", _tcp(TcpUnits), 10.0, 0.011, (-160.0, 160.0), 0.0,
        (*_UNITS, ("rate_hz", 100), ("way", "tcp: {host: 127.0.0.1, port: PLACE}")),
    ),
    "rtu": Cell(
        "units", _serial(RtuUnits), 25.0, 0.011, (-160.0, 160.0),
        names=(*_UNITS, ("rate_hz", 40), ("way", "serial: {device: PLACE, baud: 1000000}")),
    ),
    "text": Cell("text", _serial(CommandValue), 20.0, 2e-3, blind=True),
    "binary": Cell("line", _serial(Board), 10.0, 0.011, hears_by_reads=True, blind=True),
    "udp": Cell(
        "udp", lambda amplifier, _: DatagramPort(amplifier, Datagrams), 4.0, 2e-3,
        pauses=False, hears_by_reads=True, guarded=True,
    ),
    "can": Cell(
        "can", lambda amplifier, _: CanNode(amplifier, f"devices-{os.getpid()}"), 5.0, 0.006,
        (-20.0, 150.0), names=(("inputs", "Sensors."), ("outputs", "Voltages.")), pauses=False, blind=True,
    ),
    "canopen": Cell(
        "canopen", lambda amplifier, _: CanOpenNodes(amplifier, f"devices-{os.getpid()}"), 5.0, 0.006,
        least_boot_ms=0.0, names=(("inputs", "sensor."), ("outputs", "amplifier.")), pauses=False, blind=True,
    ),
    "ethercat": Cell(
        "terminals", lambda amplifier, _: VethPort(amplifier, Terminals), 4.0, 2e-3,
        least_boot_ms=0.0, pauses=False, hears_by_reads=True, guarded=True, blind=True,
    ),
}  # fmt: skip
"""By the bus between controller and device. A line resolves a step to half a count at either end of it."""
