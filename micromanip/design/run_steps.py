"""The part of a page about step responses, of one run or of two."""

from __future__ import annotations

import html
from collections.abc import Mapping, Sequence

from . import run_drawings as drawn
from .deconvolution import StepResponse
from .page import section, table

_RISE = 0.35
"""Rise time times bandwidth of a low pass."""
_ABOUT = (
    "Set-point to strain gauge, deconvolved from ordinary running, with its 95 % band; no test signal was given. "
    "What an outer loop feeds back of the gauge's own noise counts as response."
)


def steps_part(axes: Sequence[str], found: Sequence[Mapping[str, StepResponse]]) -> str:
    """HTML with picture and figures; where nothing can be said, why. `found` has the responses of each run by axis."""
    rows, silent = [], []
    for letter, responses in zip(drawn.LETTERS, found, strict=False):
        for axis in axes:
            one, name = responses[axis], axis if len(found) == 1 else f"{letter} {axis}"
            if one.problem is None:
                rows.append(_row(name, one))
            else:
                silent.append(f"<p>{html.escape(f'{name}: {one.problem}.')}</p>")
    if not rows:
        return f"<h2>Step response</h2><p>{_ABOUT}</p>{''.join(silent)}"
    head = ("axis", "rise 10-90 %, ms", "overshoot, %", "seen up to, Hz", "faster than that")
    part = section("Step response", _ABOUT, drawn.steps(axes, found))
    return f"{part}{table(head, rows)}{''.join(silent)}"


def _row(name: str, one: StepResponse) -> tuple[str, ...]:
    smoothed = f"smoothed, below {1e3 * _RISE / one.reach_Hz:.2g} ms"
    return (
        name,
        "{:.3f} +- {:.3f}".format(*one.rise_ms),
        "{:.1f} +- {:.1f}".format(*one.overshoot_percent),
        f"{one.reach_Hz:.0f}",
        "the loop has faded" if one.is_whole else smoothed,
    )
