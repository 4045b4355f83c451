"""All devices of a configuration, emulated in one process with one plant behind them."""

from __future__ import annotations

import os
import time
from pathlib import Path
from typing import Any

from micromanip.bus.cyclic import CyclicDriver
from micromanip.bus.registry import driver_class
from micromanip.bus.rights import go_before_ordinary_work, leave_cpu, lock_memory
from micromanip.emulation.can.canbus import emulate_canbus
from micromanip.emulation.can.canopen import emulate_canopen
from micromanip.emulation.ethercat.device import emulate_ethercat
from micromanip.emulation.line.device_of_a_line import emulate_line
from micromanip.emulation.modbus.units_on_a_port import emulate_modbus
from micromanip.emulation.udp.device import emulate_udp
from micromanip.errors import MicromanipError, UsageError
from micromanip.settings.check import validate
from micromanip.settings.text.source import Source
from micromanip.settings.wiring.places import build_plant
from micromanip.testbus.event_loop import EventLoop

from .amplifier import WATCHDOG_MS
from .cell import EmulatedCell
from .commands import Clear, DeviceCommand, Drift, Message, Offset, Reboot, Spoilt, device_command, parsed
from .emulated import Builder, EmulatedDevice, Surroundings
from .plant import PERIOD_NS, PlantInRealTime

_ENABLE = "amplifier_enable"
BUILDERS: dict[str, Builder] = {
    "canbus": emulate_canbus,
    "canopen": emulate_canopen,
    "ethercat": emulate_ethercat,
    "line": emulate_line,
    "modbus": emulate_modbus,
    "udp": emulate_udp,
}
"""By the driver's entry point."""
_PRIORITY = 1
_NICE = -10


class Devices:
    """On their buses at once, talking from `start` on, while the loop runs."""

    def __init__(
        self, file: Path, watchdog_ms: float = WATCHDOG_MS, seed: int | None = None, loop: EventLoop | None = None
    ) -> None:
        """Open all buses of the configuration in `file`; `seed` replaces the plant's, `loop` runs them.

        Raises ConfigError with file, line and key, and DeviceUnavailable for a channel that is in use.
        """
        source = Source.read(file)
        configuration = validate(source)
        driver = build_plant(configuration, source, PERIOD_NS, seed)
        self.loop_cpu = configuration.loop.cpu
        """The controller's, if it has one of its own."""
        self.loop = EventLoop() if loop is None else loop
        self.cell = EmulatedCell(PlantInRealTime(driver), self.loop.now_ns)
        if configuration.switches.amplifier_enable is None and _ENABLE in self.cell.plant.outputs:
            self.cell.wired_on = (_ENABLE,)
        self._began_ns, self._began_cpu_s = self.loop.now_ns(), time.process_time()
        surroundings = Surroundings(configuration, source, self.loop, self.cell, watchdog_ms)
        try:
            self.emulated: dict[str, EmulatedDevice] = emulate_all(surroundings)
        except BaseException:
            self.loop.close()
            raise

    def start(self) -> None:
        """Begin to talk; the plant's time begins too."""
        self._began_ns, self._began_cpu_s = self.loop.now_ns(), time.process_time()
        self.cell.plant.begin(self._began_ns)
        for device in self.emulated.values():
            device.start(self._began_ns)

    def close(self) -> None:
        """Let go of the buses, and of the loop."""
        for device in self.emulated.values():
            device.close()
        self.loop.close()

    def command(self, line: str) -> dict[str, Any]:
        """Do what a line of JSON says; the answer, with ``error`` where it could not be done."""
        try:
            document = parsed(line)
            if "report" in document:
                return self.report()
            if "inject" in document:
                self._inject(document)
            else:
                self._do(device_command(document))
        except MicromanipError as problem:
            return {"error": str(problem)}
        return {"ok": True}

    def report(self) -> dict[str, Any]:
        """Figures: what arrived since the last report, the rest since the start."""
        return {
            "elapsed_s": (self.loop.now_ns() - self._began_ns) * 1e-9,
            "cpu_s": time.process_time() - self._began_cpu_s,
            "devices": {name: device.report() for name, device in self.emulated.items()},
            **self.cell.report(),  # to which the devices have told theirs now
        }

    def _inject(self, document: dict[str, Any]) -> None:
        driver = document.get("driver")
        fault = {"kind": document["inject"]} | {k: v for k, v in document.items() if k not in ("inject", "driver")}
        for device in self._devices(driver):
            device.inject(fault)

    def _do(self, command: DeviceCommand) -> None:
        match command:
            case Spoilt():
                self._spoil(command.signal, command.device, 0.0, command.for_s)
            case Offset():
                self._spoil(command.signal, "offset", command.value, command.for_s)
            case Drift():
                self._spoil(command.signal, "drift", command.per_s, command.for_s)
            case Message():
                for device, message in self._messages(command.message):
                    does = device.stop_counter if command.device == "stop_counter" else device.silence
                    does(message, command.for_s)
            case Reboot():
                for device in self._devices(command.driver):
                    device.reboot(command.for_s)
            case Clear():
                self.cell.faults.clear()
                for device in self.emulated.values():
                    device.clear()

    def _spoil(self, name: str | None, kind: str, value: float, for_s: float | None) -> None:
        """One signal, or all of them."""
        known = [signal for device in self.emulated.values() for signal in device.signals]
        if name is not None and name not in known:
            raise UsageError(f"no device sends a signal {name}; there are {', '.join(known)}")
        for signal in known if name is None else [name]:
            self.cell.faults.begin(signal, kind, value, self.loop.now_ns(), for_s)

    def _devices(self, driver: Any) -> list[EmulatedDevice]:
        if driver is None:
            return list(self.emulated.values())
        if driver not in self.emulated:
            raise UsageError(f"no driver {driver} is emulated; there are {', '.join(self.emulated)}")
        return [self.emulated[driver]]

    def _messages(self, name: str | None) -> list[tuple[EmulatedDevice, str]]:
        known = [(device, message) for device in self.emulated.values() for message in device.messages]
        chosen = [(device, message) for device, message in known if name in (None, message)]
        if not chosen:
            raise UsageError(f"no device sends a message {name}; there are {', '.join(m for _, m in known)}")
        return chosen


def emulate_all(surroundings: Surroundings) -> dict[str, EmulatedDevice]:
    """The devices of all drivers that speak on a bus, by the driver's name in the configuration.

    Raises ConfigError for a driver whose device nobody can emulate, and where there is none to emulate.
    """
    devices: dict[str, EmulatedDevice] = {}
    try:
        for name, build in _builders(surroundings).items():
            devices[name] = build(name, surroundings)
    except BaseException:
        for device in devices.values():
            device.close()
        raise
    return devices


def _builders(surroundings: Surroundings) -> dict[str, Builder]:
    source, builders = surroundings.source, {}
    for name, entry in surroundings.configuration.drivers.items():
        if entry.driver in BUILDERS:
            builders[name] = BUILDERS[entry.driver]
        elif not _is_cyclic(entry.driver):
            raise source.error(("drivers", name, "driver"), f"nothing emulates a device for it; {_known()}")
    if not builders:
        raise source.error(("drivers",), f"none of them has a device to emulate; {_known()}")
    return builders


def _is_cyclic(driver: str) -> bool:
    """Such a one talks to no bus: what it needs is in the loop."""
    return issubclass(driver_class(driver), CyclicDriver)


def _known() -> str:
    return f"devices are emulated for {', '.join(BUILDERS)}"


def take_precedence(loop_cpu: int | None) -> None:
    """Off the control loop's CPU, and before ordinary work where that is permitted.

    At the least of the real-time priorities: after the loop and its bus workers, before their host and all that
    records or prints. As an ordinary process it would wait some ms for each of those, and its samples with it; an
    event loop that never comes to rest leaves the others some time all the same (``EventLoop``).
    """
    leave_cpu(loop_cpu)
    lock_memory(once_touched=True)
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(_PRIORITY))
    except PermissionError:
        go_before_ordinary_work(_NICE)
