"""Figures 2, 5, 7, 8 and 9 of the paper, as data."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from micromanip.control.system import Array
from micromanip.recordings import TimeSeries
from micromanip.rt.records import MAX_AXES
from micromanip.settings.schema.model import Configuration

from ..analyse.loop_analysis import Inverse
from ..excitation import shrinking_triangle
from ..experiment import Experiment, open_loop
from ..identify.hysteresis import HysteresisFit
from ..report.model import Curve, Plot, Section
from ..validate.evaluation import Run

_BINS, _SHOWN_BINS = 60, 585


def figure_2(voltage_V: Array, strain_um: Array) -> Plot:
    """Loops under the shrinking triangle; both (n,)."""
    loops = Curve("measured", voltage_V, strain_um)
    return Plot("Figure 2: hysteresis under a shrinking triangle", "voltage, V", "strain gauge, um", (loops,))


def figure_5(fitted: HysteresisFit, record: TimeSeries) -> tuple[Plot, Plot]:
    """Model less data over time, and over the voltage, on a record that was not fitted to."""
    t_s, voltage, strain = record.time_s, record.u, record.y
    error = fitted.predict(voltage) - strain
    late = slice(len(error) // 10, None)
    error = error - error[late].mean()
    about_s, mean_um = folded(t_s[late], error[late], _SHOWN_BINS)
    time = Plot(
        "Figure 5: model on data it was not fitted to",
        "time, s",
        "model - measured, um",
        (Curve("mean of 20 ms", about_s, mean_um),),
        f"Of a stroke of {fitted.stroke_um:.0f} um; slow movement is creep.",
    )
    rising = np.gradient(voltage) >= 0.0
    ways = (("voltage rising", rising), ("voltage falling", ~rising))
    curves = tuple(Curve(name, *folded(voltage[late][way[late]], error[late][way[late]], _BINS)) for name, way in ways)
    note = "The mean at each voltage, either way. It should have no shape."
    return time, Plot("Residual over the voltage", "voltage, V", "model - measured, um", curves, note)


def figure_7(inverse: Inverse) -> tuple[Plot, Plot]:
    """Describing function of the inverse over the amplitude."""
    swept = inverse.swept
    gain, thresholds_um = np.abs(swept.gain_V_per_um), inverse.thresholds_um
    thresholds_um = thresholds_um[thresholds_um < swept.amplitude_um[-1]]
    bends = Curve("thresholds", thresholds_um, np.interp(thresholds_um, swept.amplitude_um, gain), marks=True)
    about = f"sine about {swept.offset_um:g} um"
    return (
        Plot(
            f"Figure 7: gain of the inverse, {about}",
            "amplitude, um",
            "|N|, V/um",
            (Curve("|N(A)|", swept.amplitude_um, gain), bends),
            note="It bends wherever a play operator begins to move.",
        ),
        Plot(
            f"Figure 7: offset of the inverse, {about}",
            "amplitude, um",
            "v0, V",
            (Curve("v0", swept.amplitude_um, swept.v0_V),),
        ),
    )


def figure_8(runs: list[Run], index: int) -> tuple[Plot, ...]:
    """What is left between set-point and gauge on the faster sines, over the set-point."""
    plots = []
    for run in runs:
        if run.config == "C" and run.frequency_hz > 1.0:
            rows = run.rows["axis"][run.settled :, index]
            reference = np.asarray(rows["reference_um"], dtype=float)
            error, up = reference - rows["strain_um"], np.gradient(reference) >= 0.0
            ways = (("rising", up), ("falling", ~up))
            curves = tuple(Curve(name, *folded(reference[way], error[way], _BINS)) for name, way in ways)
            title = f"Figure 8: error over the set-point, C at {run.frequency_hz:g} Hz"
            plots.append(Plot(title, "set-point, um", "set-point - gauge, um", curves, "The mean of all periods."))
    return tuple(plots)


def figure_9(runs: list[Run], index: int) -> tuple[Plot, ...]:
    """Control error over the phase of the sine: A by itself, which is tens of times as large, B and C together."""
    plots = []
    for shown, name in ((("A",), "A"), (("B", "C"), "B and C")):
        for hertz in sorted({run.frequency_hz for run in runs}):
            curves = tuple(
                Curve(run.config, *_over_phase(run, index))
                for run in runs
                if run.frequency_hz == hertz and run.config in shown
            )
            note = "The mean of all periods; the noise of the gauge is averaged out."
            title = f"Figure 9: control error of {name} at {hertz:g} Hz"
            plots.append(Plot(title, "phase, degrees", "error, um", curves, note))
    return tuple(plots)


def _over_phase(run: Run, index: int) -> tuple[Array, Array]:
    rows = run.rows["axis"][run.settled :, index]
    turns = np.arange(len(rows)) / run.rate_hz * run.frequency_hz
    whole = turns < max(np.floor(turns[-1] + 1e-6), 1.0)
    return folded((360.0 * turns[whole]) % 360.0, (rows["reference_um"] - rows["strain_um"])[whole], 2 * _BINS)


def folded(x: Array, y: Array, bins: int) -> tuple[Array, Array]:
    """Mean of `y` (n,) in each of `bins` equal pieces of the range of `x` (n,), at their middles."""
    low, high = float(x.min()), float(x.max())
    piece = np.minimum(((x - low) / max(high - low, 1e-300) * bins).astype(int), bins - 1)
    count = np.bincount(piece, minlength=bins)
    kept = count > 0
    mean = np.bincount(piece, weights=y, minlength=bins)[kept] / count[kept]
    return low + (np.flatnonzero(kept) + 0.5) * (high - low) / bins, mean


def hysteresis_loops(configuration: Configuration, experiment: Experiment, axis: int) -> Plot:
    """Figure 2 of an experiment: linear, alternately rising and falling voltage with shrinking amplitude."""
    rate = configuration.loop.rate_hz
    triangle = shrinking_triangle(0.0, 140.0, 6, rate)
    samples = np.tile(triangle[:, None], (1, MAX_AXES))
    rows = experiment(open_loop(configuration), len(triangle) / rate, samples, every=20)["axis"]
    return figure_2(rows["voltage_V"][:, axis], rows["strain_um"][:, axis])


def paper_sections(
    configuration: Configuration, experiment: Experiment, runs: list[Run], axis: int, about: str
) -> Iterator[Section]:
    """Figures 2, 8 and 9 of one axis; `about` says where they come from."""
    plots = (hysteresis_loops(configuration, experiment, axis), *figure_8(runs, axis), *figure_9(runs, axis))
    yield Section(f"Axis {list(configuration.axes)[axis]}", about, {}, plots)
