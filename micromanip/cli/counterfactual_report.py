"""``replay --with``: what another tuning would have made of a recorded run, as a document and for people."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

from .echo import echo
from .options import Answer
from .recording_options import recorded_run


def predict_tuning(file: Path, config: Path, cut: tuple[float, float] | None) -> Answer:
    """The prediction; it ends with 1 where the cell would have stopped."""
    from micromanip.replay.counterfactual import DRAWS, FIGURES, SETTLE_S, Rerun, predict
    from micromanip.settings.tuning_hash import changes_since

    recorded, tuned, window, models = recorded_run(file, config, cut)
    rerun = Rerun(window, models)
    found = predict(rerun, tuned.parameters)
    errors: dict[str, Any] = {}
    for i, axis in enumerate(window.axes):
        was = {f"{name}_um": _known(um) for name, um in zip(FIGURES, found.recorded[:, i], strict=True)}
        expected = found.expected
        will: dict[str, Any] = {f"{name}_um": _known(um) for name, um in zip(FIGURES, expected.um[:, i], strict=True)}
        for name, low, high in zip(FIGURES, expected.low_um[:, i], expected.high_um[:, i], strict=True):
            will[f"{name}_um_interval"] = [_known(low), _known(high)]
        errors[axis] = {"recorded": was, "predicted": will}
    document = {
        "file": str(file),
        "config": str(config),
        "axes": window.axes,
        "from_s": window.at_s(window.first),
        "seconds": window.seconds,
        "armed": window.first > 0,
        "settle_s": SETTLE_S,
        "left_out_s": rerun.left_out_s,
        "draws": DRAWS,
        "errors": errors,
        "limits": [met._asdict() for met in found.limits],
        "recorded_limits": [met._asdict() for met in found.recorded_limits],
        "stopped_s": found.stopped_s,
        "stops_share": found.stops,
        "undecided": [each._asdict() for each in found.undecided],
        "outrun": found.outrun,
        "notes": [f"{file}: {change}" for _, change in changes_since(recorded.axes)],
    }
    return Answer(document, lambda: _show(document), None if found.stopped_s is None else SystemExit(1))


def _show(document: dict[str, Any]) -> None:
    from .tables import print_table

    how = "from its arming on" if document["armed"] else "from there on"
    echo(
        f"{document['config']} on {document['seconds']:.1f} s of {document['file']}, tracking from "
        f"{document['from_s']:.2f} s; in force {how}"
    )
    rows = []
    for axis, error in document["errors"].items():
        cells = []
        for name in ("rms", "p99", "peak"):
            low, high = error["predicted"][f"{name}_um_interval"]
            cells += [
                _um(error["recorded"][f"{name}_um"]),
                f"{_um(error['predicted'][f'{name}_um'])} ({_um(low)}..{_um(high, '')})",
            ]
        rows.append((axis, *cells))
    columns = ("axis", "rms recorded", "rms", "p99 recorded", "p99", "peak recorded", "peak")
    about = "in brackets: where the stage is still as its model says, to 2 % of gain and 1 % of frequency"
    print_table(columns, rows, "Path error, um", about, numbers=True)
    before = {(met["axis"], met["limit"]): met["cycles"] for met in document["recorded_limits"]}
    limits = [
        (met["axis"], met["limit"], met["value"], str(met["cycles"]), f"{met['first_s']:.4f}",
         str(before.get((met["axis"], met["limit"]), 0)))
        for met in document["limits"]
    ]  # fmt: skip
    print_table(("axis", "limit", "at", "cycles", "first, s", "cycles as recorded"), limits, "Limits it meets")
    if not limits:
        echo("It meets no limit.")
    if document["stopped_s"] is not None:
        echo(f"The cell would have stopped at {document['stopped_s']:.4f} s; figures are up to there.")
    if 0.0 < document["stops_share"] < 1.0:
        share = 100 * document["stops_share"]
        echo(f"With {share:.0f} % of the models that may be true the cell would have stopped.")
    for each in document["undecided"]:
        echo(
            f"{each['axis']}: {each['what']} ({each['code']}) comes with {each['models']} of {each['of']} models that "
            "may be true: the recording does not show whether it does, and the ranges hold both."
        )
    if document["outrun"]:
        echo(
            f"{', '.join(document['outrun'])}: the set-point would be too slow (W-217); how far that takes an axis no "
            "model tells, so its ranges have no upper end."
        )
    if document["left_out_s"] > 0.0:
        echo(
            f"Left out of all figures: {document['left_out_s']:.2f} s around missed cycles; what the other tuning "
            "would have done there, or whether the cell had stopped, the recording does not show."
        )
    for note in document["notes"]:
        echo(f"note: {note}")


def _known(um: float) -> float | None:
    return float(um) if math.isfinite(um) else None


def _um(um: float | None, unknown: str = "-") -> str:
    return unknown if um is None else f"{um:.3f}"
