"""Outputs to their safe value while no controller runs: after a crash, by hand or by the service manager.

What a worker does when its loop has died, without the loop: each value passes the same gate, from what the device reads
back or was given last. Every output of every driver is tried; what the device has not acknowledged is not called safe.
"""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field

from micromanip.bus.bridge import BusBridge
from micromanip.bus.cyclic import CyclicDriver, call_context
from micromanip.bus.device_lock import DeviceLocks
from micromanip.bus.errors import BusError
from micromanip.bus.safe_state import SafeOutput
from micromanip.errors import CheckFailed, DeviceUnavailable

from .bus_rest import BusRest
from .plan import SafePlan


@dataclass
class SafeReport:
    """What became of the outputs."""

    safe: list[str] = field(default_factory=list)
    """Drivers whose outputs have taken their safe values."""
    failed: list[str] = field(default_factory=list)
    """What can't be called safe and why, a line each."""
    notes: list[str] = field(default_factory=list)


def make_safe(plan: SafePlan, wait_s: float = 0.0, *, at_rest: bool = False) -> SafeReport:
    """Open each driver, bring its outputs to their safe values, close it again; does no harm twice.

    A person says that the outputs are `at_rest`: they begin there where a device can't be read back. Waits up to
    `wait_s` for a controller that is ramping down. Raises CheckFailed where a controller still has one of the devices:
    then nothing was touched.
    """
    wiring = plan.wiring
    outputs = {name: wiring.safe_outputs(name, plan.configuration) for name in wiring.buses}
    ramp_s = plan.configuration.start.ramp_s
    try:
        locks = DeviceLocks(wiring.devices, wait_s=wait_s)
    except DeviceUnavailable as problem:
        raise CheckFailed(f"nothing was touched: {problem}") from problem
    report = SafeReport()
    with locks, ThreadPoolExecutor() as threads:  # at the same time: none waits until another one's is given up
        tasks = {
            name: threads.submit(_one_safe, name, driver, outputs.get(name, ()), ramp_s, at_rest)
            for name, driver in wiring.drivers.items()
            if driver.outputs
        }
    for name, task in tasks.items():
        failed, notes = task.result()
        report.safe += [] if failed else [name]
        report.failed += failed
        report.notes += [f"driver {name}: {note}" for note in notes]
    return report


def _one_safe(
    name: str, driver: CyclicDriver, outputs: Sequence[SafeOutput], ramp_s: float, at_rest: bool
) -> tuple[Sequence[str], Sequence[str]]:
    """What failed, and what else is to be said."""
    try:
        if not isinstance(driver, BusBridge):
            return _make_safe(name, driver), ()
        rest = BusRest(driver.bus, outputs, ramp_s, at_rest=at_rest, simulated=driver.simulated)
        return [f"driver {name}: {line}" for line in rest.rest()], rest.notes
    except Exception as problem:  # a driver's bug keeps no other one's outputs from their safe values
        return [f"driver {name}: its outputs are unknown, bug: {type(problem).__name__}: {problem}"], ()


def _make_safe(name: str, driver: CyclicDriver) -> list[str]:
    """The same of a cyclic driver, which says itself whether it has done it."""
    functions, context = driver.functions(), driver.context()
    at = context.ctypes.data
    try:
        driver.begin(context)
    except BusError as problem:
        return [f"driver {name} could not be opened: {problem}"]
    if code := call_context(functions.open, at):
        return [f"driver {name} could not be opened: code {code}"]
    unsafe = call_context(functions.safe, at)
    unclosed = call_context(functions.close, at)
    failed = [f"driver {name}: its outputs could not be made safe, code {unsafe}"] if unsafe else []
    return failed + ([f"driver {name} could not be closed: code {unclosed}"] if unclosed else [])
