"""What no section can know alone: names that must match, stability, safety rules."""

from __future__ import annotations

import os
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from micromanip.control.joints import joints_radius
from micromanip.control.outer_gains import outer_gains
from micromanip.control.predictor import tracker_gain
from micromanip.control.tooth import followed_radius
from micromanip.settings.compile.cell import compile_cell
from micromanip.settings.compile.reference import load_samples
from micromanip.settings.schema.model import Configuration
from micromanip.settings.schema.reference import Tracker
from micromanip.settings.text.place import Finding
from micromanip.settings.text.source import Source
from micromanip.settings.wiring.buses import bus_findings, rest_findings, simulated_findings
from micromanip.settings.wiring.places import Wiring, build_plant, driver_options, wire
from micromanip.settings.wiring.timing import with_ages

from .checks.feedback import feedback_findings, feedback_warnings
from .checks.names import coupling_findings, name_findings
from .checks.ranges import actuator_findings, latency_warnings, range_findings, range_warnings
from .load import validate_document
from .tuning_hash import changes_since

_NO_SOLUTION = (np.linalg.LinAlgError, ValueError, FloatingPointError)
_LATE_PERIODS = 5
"""A loop may be late by so many periods without losing its outputs."""


@dataclass(frozen=True)
class Prepared:
    """A configuration that may be run: validated, wired, compiled."""

    configuration: Configuration
    source: Source
    wiring: Wiring
    parameters: NDArray[Any]
    samples: NDArray[np.float64]

    @cached_property
    def advice(self) -> list[Finding]:
        """What it had better not say: told by `check`, `run` and `set`, each at its key, and refused by nobody.

        Takes some 50 ms where strain loops are closed.
        """
        return [
            *changes_since(self.configuration.axes),
            *feedback_warnings(self.configuration, self.wiring),
            *range_warnings(self.configuration),
            *latency_warnings(self.configuration),
        ]

    @property
    def warnings(self) -> list[str]:
        """The advice, a line each."""
        return self.source.sentences(self.advice)

    def warnings_since(self, before: Prepared) -> list[str]:
        """The same without the advice that holds of `before`, too."""
        return self.source.sentences(each for each in self.advice if each not in before.advice)


def prepare(file: Path, seed: int | None = None) -> Prepared:
    """Load, check and compile a configuration; raises ConfigError with file, line and key of every problem.

    `seed` replaces that of the simulated drivers.
    """
    return prepared(Source.read(file), seed)


def prepared(source: Source, seed: int | None = None) -> Prepared:
    """The same of what was read already."""
    configuration, wiring = wired(source, seed)
    if configuration.simulation is not None:
        build_plant(configuration, source, configuration.loop.period_ns)
    samples = load_samples(configuration, source)
    return Prepared(configuration, source, wiring, compile_cell(configuration, wiring), samples)


def wired(source: Source, seed: int | None = None) -> tuple[Configuration, Wiring]:
    """The configuration of a file or a document with its drivers, as far as outputs and safety depend on it.

    Raises ConfigError.
    """
    configuration = validate(source)
    wiring = wire(configuration, source, seed)
    configuration = with_ages(configuration, wiring)
    _refuse(source, _wired_findings(configuration, wiring))
    return configuration, wiring


def refuse_real(prepared: Prepared) -> None:
    """Raise ConfigError for a device that is called simulated and, now that it is there, is seen to be real."""
    _refuse(prepared.source, list(simulated_findings(prepared.wiring)))


def validate(source: Source) -> Configuration:
    """The configuration of a file or a document, as far as it can be judged without its drivers; else ConfigError."""
    configuration = validate_document(source)
    _refuse(
        source,
        [
            *name_findings(configuration),
            *range_findings(configuration),
            *_machine(configuration),
            *_learning(configuration),
            *actuator_findings(configuration),
            *coupling_findings(configuration),
        ],
    )
    return configuration


def validate_with_options(source: Source) -> Configuration:
    """As `validate`, but the options of the drivers are looked at too."""
    configuration = validate(source)
    for name, entry in configuration.drivers.items():
        driver_options(source, name, entry)
    return configuration


def revise(running: Prepared, configuration: Configuration, source: Source) -> Prepared:
    """`configuration`, which `source` validated to, compiled to take the place of `running` on its drivers as they are.

    It must name the same drivers, channels and axes (see `change`); raises ConfigError as `prepare` does.
    """
    wiring = running.wiring
    configuration = with_ages(configuration, wiring)
    _refuse(source, _wired_findings(configuration, wiring))
    same = configuration.reference == running.configuration.reference
    samples = running.samples if same else load_samples(configuration, source)
    return Prepared(configuration, source, wiring, compile_cell(configuration, wiring), samples)


def _wired_findings(configuration: Configuration, wiring: Wiring) -> list[Finding]:
    """What is wrong that shows only with the drivers at hand.

    A loop over a bus that can't carry it is not judged as well: that has one cause, and needs one message.
    """
    buses = list(bus_findings(configuration, wiring))
    feedback = [] if buses else feedback_findings(configuration, wiring)
    workers = [*_workers(configuration, wiring), *_silence(configuration, wiring)]
    simulated = [*simulated_findings(wiring), *rest_findings(configuration, wiring)]
    return [
        *_safety(configuration, wiring),
        *simulated,
        *_stability(configuration),
        *workers,
        *buses,
        *feedback,
    ]


def _refuse(source: Source, findings: list[Finding]) -> None:
    if findings:
        raise source.errors(findings)


def _machine(configuration: Configuration) -> Iterator[Finding]:
    loop = configuration.loop
    if loop.spin_us * 1e3 >= loop.period_ns:
        yield ("loop", "spin_us"), f"must be shorter than the period of {loop.period_ns / 1e3:g} us"
    yield from _cpu(configuration, ("loop", "cpu"), loop.cpu)


def _cpu(configuration: Configuration, place: tuple[str, ...], cpu: int | None) -> Iterator[Finding]:
    count = os.cpu_count() or 1
    if configuration.loop.limits == "hardware" and cpu is not None and cpu >= count:
        yield place, f"this machine has the CPUs 0 to {count - 1}"


def _workers(configuration: Configuration, wiring: Wiring) -> Iterator[Finding]:
    for name in wiring.buses:
        yield from _cpu(configuration, ("drivers", name, "cpu"), wiring.bus_options(name).cpu)


def _silence(configuration: Configuration, wiring: Wiring) -> Iterator[Finding]:
    """A loop that is only late must keep its outputs: after a stall that it answers by a hold it has to move them."""
    period_ms = configuration.loop.period_ns * 1e-6
    in_a_row = configuration.faults.deadline.in_a_row or 0
    periods = max(_LATE_PERIODS, in_a_row + 2)
    given_ms = configuration.faults.link.loop_silent_ms
    if given_ms < periods * period_ms and any(bridge.outputs for bridge in wiring.buses.values()):
        yield (
            ("faults", "link", "loop_silent_ms"),
            f"{given_ms:g} ms are {given_ms / period_ms:.3g} periods of the loop: the worker would take the outputs "
            f"from one that is only late; give it {periods * period_ms:g} ms or more ({periods} periods"
            + (f", as faults.deadline.in_a_row is {in_a_row})" if in_a_row + 2 == periods else ")"),
        )


def _learning(configuration: Configuration) -> Iterator[Finding]:
    """Only what follows a tracker, with all its authority, learns."""
    if configuration.learning is None:
        return
    source = configuration.reference.source
    if not isinstance(configuration.reference, Tracker):
        yield ("learning",), f"only what follows a tracker learns: reference.source is {source}, it must be signal"
        return
    for name, axis in configuration.axes.items():
        if axis.mode != "stage":
            yield ("axes", name, "mode"), f"with learning it must be stage, not {axis.mode}"
        if axis.authority_percent != 100.0:
            yield ("axes", name, "authority_percent"), f"with learning it must be 100, not {axis.authority_percent:g}"


_LEAST_WRITES = 3
"""So many writes must fit into the time of a watchdog."""


def _safety(configuration: Configuration, wiring: Wiring) -> Iterator[Finding]:
    real = wiring.real
    if configuration.arm_on_start and real:
        yield (
            ("arm_on_start",),
            f"only a simulation may arm by itself; driver {real[0]} moves a real stage: use `micromanip arm`",
        )
    if real and configuration.start.check_s is None:
        yield ("start", "check_s"), f"driver {real[0]} moves a real stage: the polarity check can't be left out"
    for name in real:
        if configuration.loop.limits == "simulation":
            yield ("loop", "limits"), f"driver {name} moves a real stage: limits must be hardware"
        if wiring.drivers[name].watchdog is None and not configuration.drivers[name].without_watchdog:
            yield (
                ("drivers", name),
                "nothing covers a dead loop: say here what the device does by itself (watchdog: {ms, rest_ms, "
                "after_power_on}), or without_watchdog: true if it is covered otherwise",
            )
    for name, bridge in wiring.buses.items():
        keys, rates = bridge.bus.silence, [task.rate_hz for task in bridge.bus.tasks if task.outputs]
        if keys is not None and keys.ms is not None and rates and keys.ms * 1e-3 * min(rates) < _LEAST_WRITES:
            yield (
                ("drivers", name, "watchdog", "ms"),
                f"outputs are written each {1e3 / min(rates):g} ms; a watchdog of {keys.ms:g} ms would trip over one "
                f"that is late: {_LEAST_WRITES} periods are the least",
            )


def _stability(configuration: Configuration) -> Iterator[Finding]:
    tracker = configuration.reference if isinstance(configuration.reference, Tracker) else None
    if tracker is not None:
        for name in tracker.axes:
            if name not in configuration.axes:
                yield (
                    ("reference", "axes", name),
                    f"there is no axis {name}; the axes are {', '.join(configuration.axes)}",
                )
        for name in configuration.axes:
            try:
                tracker_gain(tracker.of(name))
            except _NO_SOLUTION as problem:
                where = ("reference", "axes", name) if name in tracker.axes else ("reference",)
                yield where, f"no predictor exists for these rates and noises ({problem})"
                return
            sure = tracker.of(name).sure
            try:
                surest = 0.0 if sure is None else joints_radius(sure)
            except _NO_SOLUTION as problem:
                yield ("reference", "axes", name, "steady"), f"no narrow predictor exists for these figures ({problem})"
                return
            if not surest < 1.0:
                yield (
                    ("reference", "axes", name, "steady"),
                    f"in the oscillations' ranges the narrow predictor would be unstable: a pole at radius "
                    f"{surest:.6f}; take less range_percent, or another jerk_um_per_s3",
                )
            radius = joints_radius(tracker.of(name))
            if not radius < 1.0:
                own = name in tracker.axes and tracker.axes[name].oscillations is not None
                yield (
                    ("reference", "axes", name, "oscillations") if own else ("reference", "oscillation_range_percent"),
                    f"in their ranges the predictor would be unstable: a pole at radius {radius:.6f}; take less",
                )
    for name, axis in configuration.axes.items():
        if axis.outer is None:
            continue
        try:
            gains = outer_gains(
                axis.outer, None if tracker is None else tracker.of(name), configuration.loop.period_ns * 1e-9
            )
        except _NO_SOLUTION as problem:
            yield ("axes", name, "outer"), f"no stabilising gains exist for this model and these knobs ({problem})"
            continue
        radius = float(np.abs(gains.closed_loop_poles).max())
        if axis.mode == "stage" and not radius < 1.0:
            yield ("axes", name, "outer"), f"the closed loop would be unstable: a pole at radius {radius:.6f}"
        elif axis.mode == "stage" and axis.outer.follows_tooth:
            radius = followed_radius(axis.outer, gains, configuration.loop.period_ns * 1e-9)
            if not radius < 1.0:
                place = ("axes", name, "outer", "oscillation_range_percent")
                yield (
                    place,
                    f"in it the closed loop would be unstable: a pole at radius {radius:.6f}; take less",
                )
