"""Plots of a commissioned axis as data: figures 2, 5, 7, 8 and 9 of the paper, Bode, Nyquist, step, disturbance."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..analysis import AxisAnalysis
from ..evaluation import Run
from ..loops import Margins, System, grid, refined
from .axis import Commissioned
from .evidence import Curve, Plot

Array = NDArray[np.float64]

_SHOWN_S, _ERROR_S = 5.0, 0.5
_FAR, _HIGHEST = 3.0, 1e4


def figure_2(found: Commissioned) -> Plot:
    """Loops under the shrinking triangle."""
    loops = Curve("measured", found.triangle["voltage_V"], found.triangle["strain_um"])
    return Plot("Figure 2: hysteresis under a shrinking triangle", "voltage, V", "strain gauge, um", (loops,))


def figure_5(found: Commissioned) -> tuple[Plot, Plot]:
    """Model beside data over time and as a loop, on the record that was not fitted to."""
    record = found.held_out
    t_s, voltage, strain = record["t_s"], record["voltage_V"], record["strain_um"]
    predicted = found.tanh.predict(voltage)
    error = predicted - strain
    error = error - error[len(error) // 10 :].mean()
    shown = t_s > t_s[-1] - _SHOWN_S
    time = Plot(
        "Figure 5: model on data it was not fitted to",
        "time, s",
        "strain gauge, um",
        (Curve("measured", t_s[shown], strain[shown]), Curve("tanh model", t_s[shown], (strain + error)[shown])),
    )
    rest = Plot(
        "Residual over the voltage",
        "voltage, V",
        "model - measured, um",
        (Curve("residual", voltage[len(error) // 10 :], error[len(error) // 10 :]),),
        note="It should have no shape.",
    )
    return time, rest


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
    """Reference and position on the faster sines."""
    plots = []
    for run in runs:
        if run.config == "C" and run.frequency_hz > 1.0:
            rows, t_s = _piece(run, index)
            curves = (Curve("reference", t_s, rows["reference_um"]), Curve("strain gauge", t_s, rows["strain_um"]))
            plots.append(Plot(f"Figure 8: {run.frequency_hz:g} Hz", "time, s", "position, um", curves))
    return tuple(plots)


def figure_9(runs: list[Run], index: int) -> tuple[Plot, ...]:
    """Control error of all configurations."""
    plots = []
    for hertz in sorted({run.frequency_hz for run in runs}):
        curves = []
        for run in runs:
            if run.frequency_hz == hertz and run.config in ("A", "B", "C"):
                rows, t_s = _piece(run, index)
                curves.append(Curve(run.config, t_s, rows["reference_um"] - rows["strain_um"]))
        plots.append(Plot(f"Figure 9: control error at {hertz:g} Hz", "time, s", "error, um", tuple(curves)))
    return tuple(plots)


def _piece(run: Run, index: int) -> tuple[NDArray[np.void], Array]:
    rows = run.rows["axis"][run.settled :, index]
    count = min(len(rows), round(max(_ERROR_S, 1.0 / run.frequency_hz) * 1e4))
    return rows[:count], np.asarray(np.arange(count) * 1e-4, dtype=np.float64)


def tried_orders(found: Commissioned) -> Plot:
    """Held-out error of each order of the stage's model."""
    tried = found.stage.found.tried
    order, error = np.array(list(tried), dtype=float), np.array(list(tried.values()))
    curve = Curve("held-out error", order, error, marks=True)
    note = f"1 is the measurement's own confidence; order {found.stage.found.order} is used."
    return Plot("Order of the stage's dynamics", "order", "error", (curve,), note, log_y=True)


def measured_response(found: Commissioned) -> tuple[Plot, ...]:
    """Set-point to stage: model beside the measured response, and its coherence."""
    measured = found.stage.found.measured
    hertz, seen = measured.frequency_Hz, measured.response
    pairs = (("measured", seen), ("model", found.stage.found.at(hertz)))
    gain = tuple(Curve(name, hertz, np.abs(values)) for name, values in pairs)
    phase = tuple(Curve(name, hertz, np.degrees(np.unwrap(np.angle(values)))) for name, values in pairs)
    coherence = (Curve("coherence", hertz, measured.coherence),)
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
    )


def loop_plots(name: str, loop: System, found: Margins) -> tuple[Plot, ...]:
    """Bode and Nyquist plot of an open loop."""
    omega, L = refined(loop.response, grid(loop.period_s, np.concatenate([loop.poles, _closed(loop)])))
    # an oscillator in the controller is a pole on the unit circle: its peak would be all that one sees
    kept = (omega > 2 * np.pi) & (np.abs(L) < _HIGHEST)
    hertz, L = omega[kept] / (2 * np.pi), L[kept]
    near = np.abs(L) < _FAR
    angle = np.linspace(0.0, 2 * np.pi, 181)
    circle = found.modulus * np.exp(1j * angle) - 1.0
    note = f"Gain margin {found.gain_dB:.1f} dB, phase margin {found.phase_deg:.0f} deg, Ms {found.sensitivity:.2f}."
    nyquist = (
        Curve("L", L[near].real, L[near].imag, marks=True),
        Curve("distance to -1", circle.real, circle.imag),
        Curve("-1", np.array([-1.0]), np.array([0.0]), marks=True),
    )
    return (
        Plot(f"{name}: gain", "frequency, Hz", "|L|", (Curve("|L|", hertz, np.abs(L)),), note, log_x=True, log_y=True),
        Plot(
            f"{name}: phase",
            "frequency, Hz",
            "degrees",
            (Curve("L", hertz, np.degrees(np.angle(L)), marks=True),),
            log_x=True,
        ),
        Plot(f"{name}: Nyquist", "real part", "imaginary part", nyquist, equal=True),
    )


def _closed(loop: System) -> NDArray[np.complex128]:
    return np.linalg.eigvals(loop.closed()).astype(complex)


def responses(found: Commissioned) -> tuple[Plot, Plot]:
    """Step of the stage, and what a disturbance does with and without the outer loop."""
    t_s, reference, stage = found.validation.step
    step = (Curve("reference", 1e3 * t_s, reference), Curve("capacitive sensor", 1e3 * t_s, stage))
    late, without, closed = found.validation.rejected
    both = (Curve("without outer loop", 1e3 * late, without), Curve("with outer loop", 1e3 * late, closed))
    return (
        Plot("Step of the stage, outer loop closed", "time, ms", "um", step, "Played on a fresh experiment."),
        Plot("Disturbance of 1 um at the set-point", "time, ms", "stage, um", both, "By the identified model."),
    )
