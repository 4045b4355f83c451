"""``replay --vary``: the best of many tunings on a recording, as a table and as a whole configuration."""

from __future__ import annotations

import datetime
from contextlib import nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Any

from micromanip.errors import CheckFailed

from .echo import echo
from .options import Answer
from .recording_options import recorded_run
from .results import require_new, require_room

if TYPE_CHECKING:
    from micromanip.replay.variation import Trial, Trials


def vary_tuning(
    file: Path, config: Path | None, cut: tuple[float, float] | None, *, vary: tuple[str, ...],
    trials: int, best: int, objective: str, seed: int, jobs: int | None, address: str | None, to: Path | None,
) -> Answer:  # fmt: skip
    """Run the trials, write the best of them; it ends with CheckFailed where none beats trial 0."""
    from micromanip.design.parallel import each, scheduler
    from micromanip.replay.variation import Trials, Variation, drawn, require_numbers, run_trial

    from .progress import steps

    variations = [Variation.parse(text) for text in vary]
    numbered = list(enumerate(drawn(variations, trials, seed), start=1))
    if to is not None:
        require_new(to, "--to")
        require_room(to.parent, f"--to {to}")
    _, base, window, models = recorded_run(file, config, cut, arming=False)
    require_numbers(base, variations)
    work = Trials(base, window, models, objective)
    done = [work.run(0, {})]  # compiles what the workers then load
    with steps() as bar, scheduler(address, work) if address else nullcontext():
        bar.say(f"trial 1 of {len(numbered)}")
        for trial in each(run_trial, numbered, None if address else jobs or -1, (work,)):
            done.append(trial)
            bar.say(f"trial {len(done)} of {len(numbered)}")
    ranked = sorted((trial for trial in done if trial.cost_um is not None), key=lambda trial: trial.cost_um or 0.0)
    document = {
        "file": str(file),
        "trials": len(numbered),
        "seed": seed,
        "objective": objective,
        "refused": sum(bool(trial.problem) for trial in done),
        "stopped": sum(trial.stopped for trial in done),
        "axes": window.axes,
        "base": _document(done[0], window.axes),
        "best": [_document(trial, window.axes) for trial in ranked[:best]],
        "written": None,
    }
    if to is not None and ranked and ranked[0].number:
        command = f"micromanip replay {file} {' '.join(f'--vary {text}' for text in vary)} --seed {seed}"
        text = _configuration(work, ranked[0], to, command)
        to.write_text(text, encoding="utf-8")
        document["written"] = str(to)
    unwritten = CheckFailed(f"{to} is not written: no trial is better than the tuning as it is")
    is_missing = to is not None and document["written"] is None
    return Answer(document, lambda: _show(document), unwritten if is_missing else None)


def _configuration(work: Trials, trial: Trial, to: Path, command: str) -> str:
    """The varied configuration with the values of a trial; ConfigError where `check` would refuse it as `to`."""
    from micromanip.settings.check import prepared
    from micromanip.settings.text.source import Source
    from micromanip.settings.write import with_values

    today = datetime.datetime.now(datetime.UTC).date().isoformat()
    heading = (
        f"# Trial {trial.number} of `{command}`, {today}.\n"
        f"# Predicted path error of all axes: {trial.cost_um:.4f} um. Judge its margins by `analyse margins`.\n"
    )
    text = heading + with_values(work.base.source, work.source(trial.values).data)
    prepared(Source.parse(to, text))
    return text


def _document(trial: Trial, axes: list[str]) -> dict[str, Any]:
    from micromanip.replay.counterfactual import FIGURES

    um = {f"{name}_um": dict(zip(axes, row, strict=True)) for name, row in zip(FIGURES, trial.um, strict=False)}
    return {"number": trial.number, "values": trial.values, "cost_um": trial.cost_um, **um}


def _show(document: dict[str, Any]) -> None:
    from .tables import print_table

    name, rows = document["objective"], []
    keys = list(dict.fromkeys(key for each in document["best"] for key in each["values"]))
    for each in [document["base"], *(best for best in document["best"] if best["number"])]:
        um = [each["cost_um"], *each.get(f"{name}_um", {}).values()]
        values = [f"{each['values'][key]:.4g}" if key in each["values"] else "as it is" for key in keys]
        figures = ["stops"] + ["-"] * len(document["axes"]) if um == [None] else [f"{error:.4f}" for error in um]
        rows.append((str(each["number"]), *figures, *values))
    print_table(("trial", "all axes", *document["axes"], *keys), rows, f"Path error, um, {name}", numbers=True)
    refused, stopped = document["refused"], document["stopped"]
    echo(f"{document['trials']} trials: `check` refuses {refused}, {stopped} would stop the cell.")
    if document["written"]:
        echo(f"The best is {document['written']}.")
