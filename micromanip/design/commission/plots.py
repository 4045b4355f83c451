"""Plots of a commissioned axis as data: figures 2, 5, 7, 8 and 9 of the paper, Bode, Nyquist, step, disturbance."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..analysis import AxisAnalysis
from ..evaluation import Run
from ..loops import Margins, System, grid, refined
from ..tuning import StageModel
from .axis import Commissioned
from .evidence import Curve, Plot
from .validation import Validation

Array = NDArray[np.float64]

_BINS, _SHOWN_BINS = 60, 585
_FAR, _HIGHEST = 3.0, 1e4
_COHERENT = 0.8
_MARKED_HZ = (5, 10, 20, 50, 100, 200, 500, 1000, 2000)


def figure_2(found: Commissioned) -> Plot:
    """Loops under the shrinking triangle."""
    loops = Curve("measured", found.triangle["voltage_V"], found.triangle["strain_um"])
    return Plot("Figure 2: hysteresis under a shrinking triangle", "voltage, V", "strain gauge, um", (loops,))


def figure_5(found: Commissioned) -> tuple[Plot, Plot]:
    """Model less data over time, and over the voltage, on the record that was not fitted to."""
    record = found.held_out
    t_s, voltage, strain = record["t_s"], record["voltage_V"], record["strain_um"]
    error = found.tanh.predict(voltage) - strain
    late = slice(len(error) // 10, None)
    error = error - error[late].mean()
    about_s, mean_um = folded(t_s[late], error[late], _SHOWN_BINS)
    time = Plot(
        "Figure 5: model on data it was not fitted to",
        "time, s",
        "model - measured, um",
        (Curve("mean of 20 ms", about_s, mean_um),),
        f"Of a stroke of {found.tanh.stroke_um:.0f} um; slow movement is creep.",
    )
    rising = np.gradient(voltage) >= 0.0
    ways = (("voltage rising", rising), ("voltage falling", ~rising))
    curves = tuple(Curve(name, *folded(voltage[late][way[late]], error[late][way[late]], _BINS)) for name, way in ways)
    note = "The mean at each voltage, either way. It should have no shape."
    return time, Plot("Residual over the voltage", "voltage, V", "model - measured, um", curves, note)


def figure_7(analysis: AxisAnalysis) -> tuple[Plot, ...]:
    """Describing function of the inverse over the amplitude."""
    if analysis.inverse is None:
        return ()
    swept = analysis.inverse.swept
    about = f"sine about {swept.offset_um:g} um"
    return (
        Plot(
            f"Figure 7: gain of the inverse, {about}",
            "amplitude, um",
            "|N|, V/um",
            (Curve("|N(A)|", swept.amplitude_um, np.abs(swept.gain_V_per_um)),),
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


def tried_orders(stage: StageModel) -> Plot:
    """Held-out error of each order of the stage's model."""
    tried = stage.found.tried
    order, error = np.array(list(tried), dtype=float), np.array(list(tried.values()))
    curve = Curve("held-out error", order, error, marks=True)
    note = f"1 is the measurement's own confidence; order {stage.found.order} is used."
    return Plot("Order of the stage's dynamics", "order", "error", (curve,), note, log_y=True)


def measured_response(stage: StageModel) -> tuple[Plot, ...]:
    """Set-point to stage: model beside the measured response, and its coherence."""
    measured = stage.found.measured
    hertz, seen = measured.frequency_Hz, measured.response
    pairs = (("measured", seen), ("model", stage.found.at(hertz)))
    gain = tuple(Curve(name, hertz, np.abs(values)) for name, values in pairs)
    model = np.unwrap(np.angle(pairs[1][1]))
    # measured beside the model: its own unwrapping is lost where there is noise only
    angle = np.degrees(model + np.angle(seen / pairs[1][1]))
    told = measured.coherence >= _COHERENT
    phase = (
        Curve("measured", hertz, np.where(told, angle, np.nan)),
        Curve("model", hertz, np.degrees(model)),
        Curve(f"coherence below {_COHERENT:g}", hertz, np.where(told, np.nan, angle), faint=True),
    )
    coherence = (Curve("coherence", hertz, measured.coherence),)
    beside = 100.0 * np.abs(pairs[1][1] / seen - 1.0)
    error = (
        Curve("error", hertz, np.where(told, beside, np.nan)),
        Curve(f"coherence below {_COHERENT:g}", hertz, np.where(told, np.nan, beside), faint=True),
    )
    return (
        Plot("Set-point to stage: gain", "frequency, Hz", "um/um", gain, log_x=True, log_y=True),
        Plot("Set-point to stage: phase", "frequency, Hz", "degrees", phase, log_x=True),
        Plot(
            "Coherence",
            "frequency, Hz",
            "",
            coherence,
            "Where it is low, the measured curve means nothing.",
            log_x=True,
        ),
        Plot("Model beside the measured response", "frequency, Hz", "%", error, log_x=True, log_y=True),
    )


def loop_plots(name: str, loop: System, found: Margins) -> tuple[Plot, ...]:
    """Bode and Nyquist plot of an open loop."""
    omega, L = refined(loop.response, grid(loop.period_s, np.concatenate([loop.poles, _closed(loop)])))
    # an oscillator in the controller is a pole on the unit circle: its peak would be all that one sees
    kept = (omega > 2 * np.pi) & (np.abs(L) < _HIGHEST)
    hertz, L = omega[kept] / (2 * np.pi), L[kept]
    near = np.abs(L) < _FAR
    turn = np.exp(1j * np.linspace(0.0, 2 * np.pi, 181))
    circle = found.modulus * turn - 1.0
    note = f"Gain margin {found.gain_dB:.1f} dB, phase margin {found.phase_deg:.0f} deg, Ms {found.sensitivity:.2f}."
    marked = [(each, int(np.argmin(np.abs(hertz - each)))) for each in _MARKED_HZ if hertz[0] < each < hertz[-1]]
    marked = [(each, k) for each, k in marked if near[k]]
    at = L[[k for _, k in marked]]
    nyquist = (
        Curve("L", np.where(near, L.real, np.nan), np.where(near, L.imag, np.nan)),
        Curve(f"Ms {found.sensitivity:.2f}: distance to -1", circle.real, circle.imag),
        Curve("Hz", at.real, at.imag, marks=True, texts=tuple(str(each) for each, _ in marked)),
        Curve("-1", np.array([-1.0]), np.array([0.0]), marks=True),
        Curve("unit circle", turn.real, turn.imag, faint=True),
    )
    phase = np.degrees(np.angle(L))
    phase[1:][np.abs(np.diff(phase)) > 180.0] = np.nan
    return (
        Plot(f"{name}: gain", "frequency, Hz", "|L|", (Curve("|L|", hertz, np.abs(L)),), note, log_x=True, log_y=True),
        Plot(
            f"{name}: phase",
            "frequency, Hz",
            "degrees",
            (Curve("L", hertz, phase),),
            log_x=True,
        ),
        Plot(f"{name}: Nyquist", "real part", "imaginary part", nyquist, note, equal=True),
    )


def _closed(loop: System) -> NDArray[np.complex128]:
    return np.linalg.eigvals(loop.closed()).astype(complex)


def responses(check: Validation) -> tuple[Plot, Plot]:
    """Step of the stage, and what a disturbance does with and without the outer loop."""
    t_s, reference, stage = check.step
    step = (Curve("reference", 1e3 * t_s, reference), Curve("capacitive sensor", 1e3 * t_s, stage))
    late, without, closed = check.rejected
    both = (Curve("without outer loop", 1e3 * late, without), Curve("with outer loop", 1e3 * late, closed))
    return (
        Plot("Step of the stage, outer loop closed", "time, ms", "um", step, "Played on a fresh experiment."),
        Plot("Disturbance of 1 um at the set-point", "time, ms", "stage, um", both, "By the identified model."),
    )
