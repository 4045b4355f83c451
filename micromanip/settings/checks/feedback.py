"""What the buses leave of the feedback: delay and phase margin of each strain loop, samples that are stale by design.

What stands between an actuator and the correction of its error: the time to the next sample of the gauge and its way,
two cycles of the loop (one sees the sample, the next exchange hands the voltage over), the time to the next write and
its way. The strain loop is estimated as PID times the mean slope of the hysteresis model times that delay; the PID's
output is held from sample to sample. The actuator's own lags come on top and are not known here: hence the reserve.

The outer loop applies each sample of the stage at its own time, so the sensor's way is no part of its model. The
output's way is: ``delay_cycles`` must hold what passes before any set-point can move the stage.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from micromanip.bus.driver import Channel
from micromanip.control.pid import pid_gains, pid_phase, pid_response
from micromanip.rt.laws.feedforward import (
    HYSTERESIS_PARAMETERS,
    HYSTERESIS_STATE,
    feedforward_voltage,
    start_feedforward,
)
from micromanip.settings.compile.hysteresis import fill_hysteresis
from micromanip.settings.schema.axis import Axis, Inner
from micromanip.settings.schema.hysteresis import NoModel
from micromanip.settings.schema.model import Configuration
from micromanip.settings.text.place import Finding
from micromanip.settings.wiring.places import Wiring
from micromanip.settings.wiring.timing import cycles_between, output_timing, sensor_timing, signal_timing

LEAST_DEG, RESERVE_DEG = 20.0, 30.0
"""A strain loop with less phase margin is refused; told of below the second."""
_LOOP_CYCLES = 2
_COURSE = 40
_LEAST_RISE_V = 1e-6
"""A model whose voltage hardly moves is as steep as this makes it: no loop around it has a margin."""
_GRID = 2000
_PROPOSED = np.geomspace(1.0, 1e-4, 400)


@dataclass(frozen=True)
class StrainLoop:
    """The strain loop of an axis as far as the configuration tells: crossover, phase margin, and its slowest path."""

    axis: str
    path: str
    path_s: float
    """Age of the oldest error that a voltage in force may answer to."""
    crossover_Hz: float
    phase_deg: float
    swing_Hz: float
    """Where it would begin to swing with more gain; infinite beyond what its samples show."""


def strain_loops(configuration: Configuration, wiring: Wiring) -> list[StrainLoop]:
    """The axes whose strain loop is closed."""
    return [
        strain_loop(configuration, wiring, name)
        for name, axis in configuration.axes.items()
        if axis.mode != "voltage" and axis.inner.mode != "feedforward"
    ]


def strain_loop(
    configuration: Configuration, wiring: Wiring, name: str, inner: Inner | None = None, slope: float | None = None
) -> StrainLoop:
    """The loop of the axis called `name`, with `inner` in place of its own PID where that is given.

    `slope` is its `mean_slope`, where that is known already.
    """
    axis, period_s = configuration.axes[name], configuration.loop.period_ns * 1e-9
    strain = sensor_timing(configuration, wiring, "strain", name)
    voltage = output_timing(configuration, wiring, f"voltage_{name}")
    sample_s, write_s = 1.0 / strain.rate_hz, 1.0 / voltage.rate_hz
    ways_s = strain.latency_s + voltage.latency_s + _LOOP_CYCLES * period_s
    wait_s = write_s if write_s > 1.5 * period_s else 0.0
    slope = mean_slope(configuration, name) if slope is None else slope
    found = _margins(inner or axis.running_inner, slope, sample_s, 0.5 * sample_s + ways_s + wait_s)
    return StrainLoop(name, f"{_shown(strain)} + {_shown(voltage)}", sample_s + ways_s + write_s, *found)


def mean_slope(configuration: Configuration, name: str) -> float:
    """Slope (um/V) of an actuator between the ends of its range: of its model, else as range by range of the output."""
    axis, output = configuration.axes[name], configuration.outputs[f"voltage_{name}"]
    low_um, high_um = axis.setpoint.range_um
    if isinstance(axis.hysteresis, NoModel):
        return (high_um - low_um) / (output.range_V[1] - output.range_V[0])
    low_um, high_um = axis.hysteresis.range_um
    p, s = np.zeros(1, HYSTERESIS_PARAMETERS)[0], np.zeros(1, HYSTERESIS_STATE)[0]
    fill_hysteresis(p, axis.hysteresis, configuration.loop.period_ns * 1e-9)
    start_feedforward(p, s, low_um, 0.0)
    ends = []
    for first, last in ((low_um, high_um), (high_um, low_um), (low_um, high_um)):
        ends.append([float(feedforward_voltage(p, s, y)) for y in np.linspace(first, last, _COURSE)][-1])
    rise_V = ends[2] - ends[1]
    return (high_um - low_um) / rise_V if abs(rise_V) > _LEAST_RISE_V else (high_um - low_um) / _LEAST_RISE_V


def feedback_findings(configuration: Configuration, wiring: Wiring) -> Iterator[Finding]:
    """What can't work: strain loops without phase margin, outer loops for other rates, samples stale by design."""
    impossible = list(_impossible(configuration, wiring))
    yield from impossible
    for loop in strain_loops(configuration, wiring) if not impossible else ():
        if not loop.phase_deg >= LEAST_DEG:
            fits = fitting_gain(configuration, wiring, loop.axis)
            yield (
                ("axes", loop.axis, "inner", "K_V_per_um"),
                f"the strain loop would have {loop.phase_deg:.0f} deg of phase margin at {loop.crossover_Hz:.0f} Hz, "
                f"at least {LEAST_DEG:g} are needed: its slowest path is {loop.path}, {1e3 * loop.path_s:.2g} ms; "
                f"with this Ti_ms and Td_ms {fits:.2g} would fit, or commission the axis again",
            )
    for name, axis in configuration.axes.items():
        if axis.mode == "stage":
            yield from _outer_findings(configuration, wiring, name, axis)
    for name, signal in configuration.signals.items():
        channel = signal_timing(configuration, wiring, name)
        at_once = channel.rate_hz >= configuration.loop.rate_hz and channel.latency_s == 0.0
        if signal.max_age_us is None or at_once:
            continue
        latency_us, between_us = 1e6 * channel.latency_s, 1e6 / channel.rate_hz
        if signal.max_age_us < latency_us + between_us:
            yield (
                ("signals", name, "max_age_us"),
                f"stale by design: a sample is up to {latency_us + between_us:.0f} us old before the next one comes "
                f"({channel.rate_hz:g} Hz, latency {latency_us:.0f} us); {latency_us + 3.0 * between_us:.0f} would "
                "allow for two lost ones",
            )


def _impossible(configuration: Configuration, wiring: Wiring) -> Iterator[Finding]:
    """PIDs that can't be stepped at the rate of their gauge."""
    for name, axis in configuration.axes.items():
        strain = sensor_timing(configuration, wiring, "strain", name)
        try:
            pid_gains(axis.inner, 1.0 / strain.rate_hz)
        except ValueError as problem:
            yield ("axes", name, "inner"), f"{problem} ({_shown(strain)})"


def feedback_warnings(configuration: Configuration, wiring: Wiring) -> Iterator[Finding]:
    """What works, but not well."""
    for loop in strain_loops(configuration, wiring):
        if LEAST_DEG <= loop.phase_deg < RESERVE_DEG:
            yield (
                ("axes", loop.axis, "inner"),
                f"the strain loop has only {loop.phase_deg:.0f} deg of phase margin at "
                f"{loop.crossover_Hz:.0f} Hz over {loop.path}, {1e3 * loop.path_s:.2g} ms; K_V_per_um: "
                f"{fitting_gain(configuration, wiring, loop.axis):.2g} would leave {RESERVE_DEG:g}",
            )
        band_Hz = configuration.axes[loop.axis].faults.oscillation.band_Hz
        if loop.swing_Hz < band_Hz[0]:
            yield (
                ("axes", loop.axis, "faults", "oscillation", "band_Hz"),
                f"over {loop.path} the strain loop would swing near {loop.swing_Hz:.0f} Hz, below {list(band_Hz)}; "
                f"[{0.5 * loop.swing_Hz:.0f}, {2 * loop.swing_Hz:.0f}] sees it",
            )


def fitting_gain(configuration: Configuration, wiring: Wiring, name: str) -> float:
    """The largest K_V_per_um, up to that of the axis, with the whole reserve."""
    inner, slope = configuration.axes[name].inner, mean_slope(configuration, name)
    for share in _PROPOSED:
        gain = float(f"{share * inner.K_V_per_um:.2g}")
        tried = strain_loop(configuration, wiring, name, inner.model_copy(update={"K_V_per_um": gain}), slope)
        if tried.phase_deg >= RESERVE_DEG:
            return gain
    return float(_PROPOSED[-1] * inner.K_V_per_um)


def _outer_findings(configuration: Configuration, wiring: Wiring, name: str, axis: Axis) -> Iterator[Finding]:
    if axis.outer is None:
        return
    stage = sensor_timing(configuration, wiring, "stage", name)
    between = cycles_between(configuration, stage)
    if axis.outer.sample_cycles != between:
        yield (
            ("axes", name, "outer", "sample_cycles"),
            f"{axis.outer.sample_cycles} does not go with {_shown(stage)}: at {configuration.loop.rate_hz} cycles a "
            f"second a sample comes every {between}; write {between}",
        )
    voltage = output_timing(configuration, wiring, f"voltage_{name}")
    least = math.floor(voltage.latency_s * configuration.loop.rate_hz + 1e-6)
    if axis.outer.model.delay_cycles < least:
        yield (
            ("axes", name, "outer", "model", "delay_cycles"),
            f"{axis.outer.model.delay_cycles} leaves out the way of voltage_{name}, {1e6 * voltage.latency_s:.0f} us: "
            f"at least {least}; commission the axis again, with the model for this bus",
        )


def _shown(channel: Channel) -> str:
    return f"{channel.name} {channel.rate_hz:g} Hz"


def _margins(inner: Inner, slope: float, sample_s: float, delay_s: float) -> tuple[float, float, float]:
    """Crossover (Hz) with the least phase margin, that margin (deg), and where the phase is -180 deg (Hz)."""
    omega = np.geomspace(1e-4, 1.0, _GRID) * math.pi / sample_s
    size = np.abs(slope * pid_response(inner, sample_s, omega) * np.sinc(0.5 * omega * sample_s / math.pi))
    phase_deg = np.degrees(pid_phase(inner, sample_s, omega) - omega * delay_s)
    crossing = np.flatnonzero((size[:-1] > 1.0) != (size[1:] > 1.0))
    if size[-1] > 1.0:
        crossing = np.append(crossing, _GRID - 1)
    beyond = np.flatnonzero(phase_deg < -180.0)
    swing_Hz = float(omega[beyond[0]] / (2 * math.pi)) if len(beyond) else math.inf
    if not len(crossing):
        return 0.0, math.inf, swing_Hz
    worst = crossing[np.argmin(phase_deg[crossing])]
    return float(omega[worst] / (2 * math.pi)), float(180.0 + phase_deg[worst]), swing_Hz
