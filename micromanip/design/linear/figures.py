"""Pictures of a linear fit: singular values, Bode beside the measured response, free run beside held-out data."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from micromanip.design.canvas import panels, save

from .judged import Judged

_SHOWN = 2000
_VALUES = 30
_POINTS = 500
_TRUSTED = 0.6
"""Coherence below which the measured response is drawn faintly."""


def singular_values(result: Judged) -> Figure:
    """Singular values of the projection; below, the held-out error of each order, where orders were tried."""
    model = result.model
    compared = len(model.tried) > 1
    figure, both = panels(1 + compared, f"Order {model.order}", 1.0 + 0.4 * compared)
    values = model.singular_values[: max(_VALUES, 2 * model.order)]
    both[0].semilogy(np.arange(1, len(values) + 1), values, "o", ms=4)
    both[0].set(xlabel="number", ylabel="singular value")
    if compared:
        both[1].semilogy(list(model.tried), list(model.tried.values()), "o-", ms=4)
        both[1].set(xlabel="order", ylabel="held-out error, % of the outputs")
    for panel in both:
        panel.axvline(model.order + 0.5 * (panel is both[0]), color="tab:red", lw=0.8, ls="--")
        panel.grid(alpha=0.3)
    return figure


def bode(result: Judged, output: int, driven: int) -> Figure:
    """Model beside the measured frequency response, from input number `driven` to `output`, and the coherence."""
    measured, record = result.measured, result.held_out[0]
    figure, (gain, phase, coherence) = panels(3, f"{record.outputs[output]} over {record.inputs[driven]}", 1.8)
    # evenly over the logarithmic axis: all points would hide one another
    shown = np.unique(np.geomspace(1, len(measured.frequency_Hz), _POINTS).astype(int)) - 1
    hz, seen = measured.frequency_Hz[shown], measured.coherence[shown, output]
    points = measured.response[shown, output, driven]
    model = result.model.frequency_response(hz)[:, output, driven]
    # degrees of the measurement are unwrapped to those of the model
    angle = np.rad2deg(np.unwrap(np.angle(model)))
    beside = angle + np.rad2deg(np.angle(points / np.where(model == 0, 1.0, model)))
    for trusted, alpha in ((seen < _TRUSTED, 0.2), (seen >= _TRUSTED, 1.0)):
        label = "measured" if alpha == 1.0 else None
        gain.loglog(hz[trusted], np.abs(points[trusted]), ".", ms=3, color="tab:blue", alpha=alpha, label=label)
        phase.semilogx(hz[trusted], beside[trusted], ".", ms=3, color="tab:blue", alpha=alpha)
    gain.loglog(hz, np.abs(model), color="tab:orange", lw=1.2, label=f"model, order {result.model.order}")
    phase.semilogx(hz, angle, color="tab:orange", lw=1.2)
    coherence.semilogx(hz, seen, lw=0.8)
    sizes = np.abs(np.concatenate([model, points[seen >= _TRUSTED]]))
    gain.set(ylabel="gain", ylim=(0.5 * max(sizes.min(), 1e-5 * sizes.max()), 2.0 * sizes.max()))
    gain.legend()
    phase.set(ylabel="phase, degrees")
    coherence.set(xlabel="frequency, Hz", ylabel="coherence", ylim=(0.0, 1.05))
    for panel in (gain, phase, coherence):
        panel.grid(alpha=0.3, which="both")
        panel.set_xlim(hz[0], hz[-1])
    return figure


def free_run(result: Judged) -> Figure:
    """Free run beside the data that was held out, a panel an output; what is left of it below each."""
    record, model = result.held_out[0], result.model
    predicted = model.simulate(record.u, record.y)
    shown = slice(0, _SHOWN)
    count = len(record.outputs)
    figure, axes = panels(2 * count, "Free run on data that was not fitted to", 0.9 * count)
    seconds = np.arange(len(record.u))[shown] * record.dt
    for o, name in enumerate(record.outputs):
        top, rest = axes[2 * o], axes[2 * o + 1]
        top.plot(seconds, record.y[shown, o], label="measured", lw=1.4)
        top.plot(seconds, predicted[shown, o], "--", label=f"model, fit {result.fit_percent[o]:.1f} %", lw=1.0)
        rest.plot(seconds, (record.y - predicted)[shown, o], lw=0.7)
        top.set(ylabel=name)
        rest.set(ylabel="error")
        top.legend(loc="upper right", fontsize="small")
    axes[-1].set(xlabel="time, s")
    for panel in axes:
        panel.grid(alpha=0.3)
    return figure


def draw_linear(result: Judged, folder: Path) -> list[Path]:
    """Draw all of them into `folder`; the files."""
    files = [save(singular_values(result), folder, "singular_values")]
    record = result.held_out[0]
    for o, output in enumerate(record.outputs):
        for i, driven in enumerate(record.inputs):
            files.append(save(bode(result, o, i), folder, f"bode_{_plain(driven)}_{_plain(output)}"))
    return [*files, save(free_run(result), folder, "free_run")]


def _plain(name: str) -> str:
    return "".join(letter if letter.isalnum() or letter in "-_" else "_" for letter in name)
