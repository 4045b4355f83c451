"""docs/accuracy.md: the tables."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from micromanip.design import paper

from .cells import FIRST_PLANT, ROOT, SEED
from .figures import COHERENCE_S, LIMITED, NOW, PLAYED_S, PLAYED_SEED, Reached, Values

PAGE = ROOT / "docs" / "reports" / "accuracy.md"
ASKED = {"D 1": 0.020, "D 5": 0.030, "D 10": 0.035}
"""Of the true position, um: what was aimed at."""
ASKED_FAST = {
    "D 100 Hz, 10 um": 0.12,
    "D 50 Hz, 10 um, % of the stroke": 0.15,
    "D 150 Hz, 10 um, % of the stroke": 0.30,
}
_PAGE = f"""\
# Accuracy: what the cell reaches

Made by `make accuracy` ([`tools/accuracy`](../tools/accuracy/__main__.py)), in virtual time but for
[the real loop](#the-real-loop), by the simulation's truth.
The axes {{axes}} are those of `config/factory.yaml`, commissioned with the seed {SEED} and played with the noise of
seed {PLAYED_SEED}. The drawn plants are the seeds {FIRST_PLANT} to {{last}} of the family of `make robustness`
([page](commissioning.md#how-far-to-trust-it)), {{drawn}} in all, each commissioned from factory values. {{passed}}
passed and are in the tables; those that did not stand at the end, with the reason.

## Path error

Rms, um, over {PLAYED_S:g} s of tracking while the tool cuts. The paper closes no outer loop and has no path error.

{{path}}

The bound is that of [the error budget](budget.md#the-bound): no causal controller with these sensors goes below it,
where phases are known for {COHERENCE_S:g} s. It asks for no margins, and a loop that bears another plant is above it;
nor does it count the zeros that a second flexure mode puts outside the unit circle, which
[bound most drawn plants](budget.md#the-forces-share-what-bounds-it).
A drawn actuator may be too weak for the common path: at an end of its voltage or set-point nothing is corrected.
Of the {{free}} that never came to one the median is {{free_um}} um.

### The real loop

The same axes, as `commission` leaves them, in the real loop at 10 kHz on the machine that made this page
({{machine}}): {{real_s:g}} s, in which {{overruns}} cycles came too late.

{{real}}

### What it is made of

Computed from the models ([error budget](budget.md)), um rms; each cause beside the least that any causal law leaves
of it.

{{causes}}

### Other trackers

The axes {{axes}} commissioned anew behind trackers of other noise: what the tracker's samples leave, computed, um rms.

{{trackers}}

## Sines on the gauge

The paper's experiment (its Table 1), 70 um + 30 um sin, without machining: sigma of set-point less position, um, by
configuration and frequency in Hz. {{letters}}, D: the tanh inverse with the axis' own PID.

With the paper's one PID {{faulty}} of the drawn plants end in a limit cycle: in A, B and C they are not counted.

Measured by the gauge, whose own noise is .055 um; the paper's figures are of its own stage:

{{gauge}}

True position:

{{true_gauge}}

## Fast sines

True position, sigma in um, or rms in percent of the stroke, peak to peak, as is usual with scanning microscopes:
published of one with inversion-based control are .73 and 1.67 % at 50 and 150 Hz. A plant that does not bear a sine is
not counted in its row.

{{fast}}

## On other pages

[Budgets beside experiments](budget.md#how-good-it-is) (`make check-budget`), [coupled axes](coupling.md)
(`make check-coupling`), [a tooth at another speed](tooth.md) (`make check-tooth`), [previews](preview.md)
(`make check-preview`).
"""


@dataclass(frozen=True)
class RealLoop:
    """A run of the real loop: rms and greatest path error (um) by axis, how long, on what, and how it kept its time."""

    path: Mapping[str, Values]
    seconds: float
    overruns: int
    machine: str


def lines(rows: Iterable[str], columns: Mapping[str, Mapping[str, float]], digits: int = 3) -> list[str]:
    """A table in Markdown: a line for each row, a column for each of `columns`; what isn't there is left open."""
    head = ["| |", "|---|"]
    body = {row: f"| {row} |" for row in rows}
    for name, values in columns.items():
        head = [head[0] + f" {name} |", head[1] + "---|"]
        for row in body:
            body[row] += f" {values[row]:.{digits}f} |" if row in values else " |"
    return [*head, *body.values()]


def spread(found: Sequence[Values]) -> tuple[Values, Values]:
    """Median and worst by row."""
    rows = dict.fromkeys(row for each in found for row in each)
    every = {row: [each[row] for each in found if row in each] for row in rows}
    return {row: float(np.median(v)) for row, v in every.items()}, {row: max(v) for row, v in every.items()}


def page(
    own: Mapping[str, Reached],
    plants: Mapping[int, Reached | str],
    real: RealLoop,
    trackers: Mapping[str, Values],
) -> str:
    """The page; `trackers` by axis: what is left and what the bound is, a row for each noise."""
    good = [each for each in plants.values() if isinstance(each, Reached)]
    refused = {seed: why for seed, why in plants.items() if isinstance(why, str)}
    free = [each.path[NOW] for each in good if not each.path.get(LIMITED)]

    def columns(kind: str) -> dict[str, Values]:
        found = {axis: getattr(each, kind) for axis, each in own.items()}
        middle, worst = spread([getattr(each, kind) for each in good])
        return found | {"drawn, median": middle, "drawn, worst": worst}

    first = next(iter(own.values()))
    papers = {f"{letter} {hertz:g}": um for letter, row in paper.SIGMA_UM.items() for hertz, um in row.items()}
    text = _PAGE.format(
        axes=", ".join(own),
        drawn=len(plants),
        passed=len(good),
        faulty=sum(not each.bears_the_papers_pid for each in good),
        last=FIRST_PLANT + len(plants) - 1,
        free=len(free),
        free_um=f"{np.median(free):.3f}" if free else "-",
        path="\n".join(lines(first.path, columns("path"))),
        machine=real.machine,
        real_s=real.seconds,
        overruns=real.overruns,
        real="\n".join(lines(next(iter(real.path.values())), real.path)),
        causes="\n".join(lines(first.causes, columns("causes"))),
        trackers="\n".join(lines(next(iter(trackers.values())), trackers)),
        letters=", ".join(f"{letter}: {label}" for letter, label in paper.LABELS.items()),
        gauge="\n".join(lines(first.gauge, {"paper": papers, **columns("gauge")})),
        true_gauge="\n".join(lines(first.true_gauge, {"aim": ASKED, **columns("true_gauge")})),
        fast="\n".join(lines(first.fast, {"aim": ASKED_FAST, **columns("fast")})),
    )
    if refused:
        text += "\n".join(["", "## Plants that did not pass", "", *(f"- {k}: {why}" for k, why in refused.items()), ""])
    return text
