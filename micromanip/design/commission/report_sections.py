"""What was done and found on one axis, section by section, for the report."""

from __future__ import annotations

import numpy as np

from ..analyse.axis import AxisAnalysis
from ..analyse.loops import damped
from ..identify.models import StageModel
from ..plots.loops import loop_plots
from ..plots.paper import figure_2, figure_5, figure_7, figure_8, figure_9
from ..report.model import Curve, Evidence, Plot, Section
from ..validate.evaluation import Run
from . import prices
from .acceptance import acceptance
from .axis import Commissioned
from .closing import ClosedOuter
from .validation import Validation, asked


def evidence(found: Commissioned, analysis: AxisAnalysis, runs: list[Run], index: int) -> Evidence:
    """The whole of it for one axis; `runs` are its sines, in whose rows it is axis number `index`."""
    loops = {"strain": (found.pid.limited_by, found.strain_prices)}
    if found.outer is not None:
        loops["outer"] = found.outer.design.limited_by, found.outer.prices
    sections = (
        prices.section(loops),
        *([Section("Done again", "\n\n".join(found.learned))] if found.learned else []),
        _first_move(found),
        _hysteresis(found),
        _inverse(analysis),
        _strain(found, analysis),
        *(() if found.outer is None else (_stage(found.outer), _outer(found, found.outer, analysis))),
        _experiment(found, runs, index),
    )
    return Evidence(found.axis, acceptance(found, analysis, runs, index), sections)


def _first_move(found: Commissioned) -> Section:
    moved = {f"gauge {name}": f"{value:+.3f} um" for name, value in found.polarity.moved_um.items()}
    figures = {"voltage": f"{found.polarity.moved_V:+.1f} V"} | moved
    return Section(
        "First move",
        "A small move from the park voltage in open loop: the right gauge must see it, and the right way.",
        figures | {"slope": f"{found.polarity.slope_um_per_V:.3f} um/V"},
        (figure_2(found.triangle.u, found.triangle.y),),
    )


def _hysteresis(found: Commissioned) -> Section:
    voltage = found.record.u
    figures = {
        "record": f"{voltage.min():.0f} to {voltage.max():.0f} V, {found.tanh.stroke_um:.0f} um of stroke",
        "coverage of the set-points": f"{100 * found.quality.coverage:.0f} %",
        "least slope": f"{100 * found.quality.flattest:.0f} % of the median",
    }
    for name, fitted in (("tanh", found.tanh), ("affine", found.affine)):
        held_out = found.held_out_percent[fitted.structure.name]
        figures[name] = f"{fitted.rms_percent:.2f} % fitted, {held_out:.2f} % on the second record"
    text = "Multisine (13) in open loop, twice: the models are fitted to one record and judged by the other."
    return Section("Hysteresis", text, figures, figure_5(found.tanh, found.held_out))


def _inverse(analysis: AxisAnalysis) -> Section:
    text = "Describing function (18)-(24) of the inverse that runs as feedforward."
    return Section("Inverse", text, {}, () if analysis.inverse is None else figure_7(analysis.inverse))


def _strain(found: Commissioned, analysis: AxisAnalysis) -> Section:
    inner, pid = found.pid.inner, found.pid
    figures = {
        "K": f"{inner.K_V_per_um:g} V/um",
        "Ti": f"{inner.Ti_ms:g} ms",
        "Td": f"{inner.Td_ms:g} ms",
        "Ms at the worst slope": f"{pid.sensitivity:.2f}",
        "noise gain": f"{pid.noise_gain:.3f}",
        "left of a disturbance at 10 Hz": f"{100 * pid.residual_10Hz:.1f} %",
        "actuator's model": f"order {found.actuator.found.order}, measured {found.actuator.attempts} times, "
        f"{found.actuator.found.fit_percent:.0f} % fit about {found.actuator.centre_V:.0f} V",
    }
    if found.undone is not None:
        section = found.undone.actuator
        (before, _), (after, worst) = (found.undone.tried[name] for name in ("nothing", found.undone.last))
        figures["undone in mode strain"] = (
            f"{', '.join(found.undone.taken) or 'nothing'}; {section.feedback_percent:g} % of the PID; sines to 150 "
            f"Hz, by the model: {100 * before:.1f} % of the amplitude to {100 * after:.1f}, at worst {100 * worst:.1f}"
        )
    plots: tuple[Plot, ...] = ()
    if analysis.strain is not None:
        worst = int(np.argmax([m.sensitivity for m in analysis.strain.margins]))
        plots = loop_plots(
            f"Strain loop at its worst slope, {analysis.strain.slopes[worst]:.2f} times the identified one",
            analysis.strain.loops[worst],
            analysis.strain.margins[worst],
        )
    text = (
        "The PID with the least cost. The cost adds the residual error, which feedback leaves, and the gauge noise, "
        "which feedback amplifies. The sensitivity stays below its limit at every slope of the hysteresis and within "
        "the uncertainty of the measured response."
    )
    return Section("Strain PID", text, figures, plots)


def _stage(found: ClosedOuter) -> Section:
    mode_Hz, damping = resonance(found.stage)
    figures = {
        "model": f"order {found.stage.found.order} behind {found.stage.linear.delay_cycles} cycles",
        "model beside the measured response": f"{found.stage.found.fit_percent:.1f} %",
        "first mode": f"{mode_Hz:.1f} Hz, damping {damping:.3f}",
    }
    text = (
        "A multisine on the set-point excites the stage. The strain loop of this axis is closed; the other axes rest "
        "at their park voltages."
    )
    return Section("Stage dynamics", text, figures, measured_response(found.stage))


def resonance(stage: StageModel) -> tuple[float, float]:
    """Frequency (Hz) and damping ratio of the least damped mode of the stage's model."""
    swinging = [damped(pole, stage.found.dt) for pole in stage.found.modes.poles if pole.imag > 0.0]
    return min(swinging, key=lambda mode: mode[1], default=(float("nan"), 1.0))


def _outer(found: Commissioned, closed: ClosedOuter, analysis: AxisAnalysis) -> Section:
    outer, design = closed.design.outer, closed.design
    figures = {
        "control weight": f"{outer.control_weight:g}",
        "random walk": f"{outer.disturbance_um:g} um a cycle",
        "sensor noise": f"{1e3 * outer.sensor_noise_um:.1f} nm",
        "noise of the set-point": f"{outer.input_noise_um:g} um a cycle",
        "bandwidth": f"{design.bandwidth_Hz:.0f} Hz",
        "step, by the model": f"{100 * design.step.overshoot:.0f} % over, settled after "
        f"{1e3 * design.step.settling_s:.0f} ms",
        "error at rest after the step": f"{1e3 * closed.validation.settled_um:.0f} nm rms",
    }
    for name, share in found.coupling.items():
        figures[f"seen by {name}"] = f"{100 * share:+.2f} %"
    plots = () if analysis.stage is None else loop_plots("Outer loop", analysis.stage.loop, design.margins)
    text = (
        "Kalman filter and LQG on the capacitive sensor: of those whose step is as accepted and that keep their "
        "margins, the one that leaves least of a disturbance. The curves are the model's, the "
        "criteria's gain margin and Ms the worst within what the measured response leaves open."
    )
    return Section("Outer loop", text, figures, (*plots, step_response(closed.validation)))


def _experiment(found: Commissioned, runs: list[Run], index: int) -> Section:
    figures, (offset_um, amplitude_um) = {}, asked(found.configuration, found.axis)
    for run in runs:
        if run.config in ("A", "B", "C"):
            row = run.figures(found.axis, index)
            name = f"{run.config}, {run.frequency_hz:g} Hz"
            figures[name] = f"sigma {row['std_error_um']:.4f} um, maximum {row['max_error_um']:.2f} um"
    text = (
        f"{offset_um:.0f} um + {amplitude_um:.0f} um sin. A: PID alone, B: with affine inverse, C: with tanh "
        "inverse; all with the new PID."
    )
    return Section("Sines on the gauge", text, figures, (*figure_8(runs, index), *figure_9(runs, index)))


_COHERENT = 0.8


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


def step_response(check: Validation) -> Plot:
    """Of the stage, on a fresh experiment."""
    t_s, reference, stage = check.step
    curves = (Curve("reference", 1e3 * t_s, reference), Curve("capacitive sensor", 1e3 * t_s, stage))
    return Plot("Step of the stage, outer loop closed", "time, ms", "um", curves, "Played on a fresh experiment.")
