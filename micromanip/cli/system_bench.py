"""``micromanip system bench``: how fast this machine runs the controller, each figure beside a reference."""

from __future__ import annotations

import importlib
import sys
from functools import partial
from pathlib import Path
from typing import Any

import click

import micromanip
from micromanip.errors import CheckFailed, DeviceUnavailable

from .echo import echo
from .options import emit_answer, subcommand
from .progress import steps

_PAIRS, _LATENESS_S = 15, 2.0
"""Interleaved pairs; length of each measurement of lateness."""


@subcommand("bench", "micromanip system bench --only cycle --only offline")
@click.option("--only", multiple=True, metavar="NAME", help="One of the names below; may be repeated.")
def command(only: tuple[str, ...], as_json: bool) -> None:
    """Measure the speed of this machine, each figure beside a reference measured in the same run.

    cycle: three axes beside the same cycle in plain C, in a warm cache and (cycle_cold) behind a neighbour that empties
    it. cycle_laws: with every law switched on, beside the configuration as it is.
    lateness: wake-ups of the loop process beside cyclictest.
    offline: simulation beside real time. startup: command to READY, and memory, beside Python's own.
    can_frames: frames a second of the driver canbus in Python and compiled, and can_worker: use of a CPU by the worker
    of config/can.yaml, each beside bare python-can. modbus: transactions of the driver modbus beside the bare library.
    line: frames, lines and packets of the driver line beside bare pyserial and sockets. ethercat_exchange: of the
    driver ethercat beside the same in C.

    Where the machine lacks what one of them needs (gcc, cyclictest, rights), that is said and it is skipped. Ends with
    1 where one finds the controller itself wrong; the others are measured all the same.
    """
    root = source_tree()
    runner = importlib.import_module("benchmarks.runner")
    with steps() as bar:
        tell = bar.say if bar.console.is_terminal else partial(echo, err=True)
        settings = runner.Plan(root / "config" / "paper.yaml", _PAIRS, _LATENESS_S, tell)
        document = runner.run(settings, only).document()
    emit_answer(document, _table, as_json)
    if document["failed"]:
        raise CheckFailed(f"failed, as said above: {', '.join(row['name'] for row in document['failed'])}")


def source_tree() -> Path:
    """The root that holds the package `benchmarks`, now importable; DeviceUnavailable where there is none."""
    assert micromanip.__file__ is not None
    root = Path(micromanip.__file__).parent.parent
    if not (root / "benchmarks" / "runner.py").is_file():
        raise DeviceUnavailable("system bench needs the source tree of micromanip, which this installation lacks")
    if str(root) not in sys.path:
        sys.path.insert(0, str(root))
    return root


def _table(document: dict[str, Any]) -> None:
    from .tables import print_table

    rows = []
    for row in document["results"]:
        value, reference = (f"{row[key]:g} {row['unit']}" for key in ("value", "reference_value"))
        rows.append((row["name"], value, row["reference_name"], reference, f"{row['ratio']:g}"))
    for outcome in ("skipped", "failed"):
        rows += [(row["name"], outcome, row["reason"], "", "") for row in document[outcome]]
    print_table(("figure", "value", "reference", "", "ratio"), rows)
