"""``micromanip replay RECORDING``: a recorded run again, bit for bit."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import click

from .options import StrictCommand, json_option, print_answer


@click.command("replay", cls=StrictCommand, epilog="Example: micromanip replay out/run.mcap")
@click.argument("file", type=click.Path(path_type=Path), metavar="RECORDING")
@json_option
def command(file: Path, as_json: bool) -> None:
    """Run the cycles of a recording once more on what came in, and compare each number bit for bit.

    Voltages, set-points, estimates, feedforward, feedback, states and faults. Exit code 0 where all are equal, 1 where
    one is not: the first is shown, with what probably made it differ.
    """
    from micromanip.recordings import open_telemetry
    from micromanip.replay import replay
    from micromanip.rt.jit import Compiler

    Compiler.tell = staticmethod(lambda name: click.echo(f"compiling {name} (the first time only)", err=True))
    found = replay(open_telemetry(file))
    difference = found.difference
    document = {
        "file": str(file),
        "axes": found.axes,
        "rows": found.rows,
        "cycles": found.cycles,
        "equal": difference is None,
        "left_out": found.left_out,
        "skipped": found.skipped,
        "swaps": found.swaps,
        "commands": dict(found.commands),
        "gaps": found.gaps,
        "lacks": found.lacks,
        "other_version": found.is_other_version,
        "difference": None
        if difference is None
        else {
            "cycle": difference.cycle,
            "t_s": difference.t_s,
            "values": [value._asdict() for value in difference.values],
            "cause": difference.cause,
        },
    }
    print_answer(document, _show, as_json)
    sys.exit(0 if difference is None else 1)


def _show(document: dict[str, Any]) -> None:
    difference, axes = document["difference"], len(document["axes"])
    counted = f"{document['cycles']} cycles, {axes} {'axis' if axes == 1 else 'axes'}"
    met = [f"{count} x {name}" for name, count in document["commands"].items()]
    met += [f"{document['swaps']} changes of parameters"] if document["swaps"] else []
    met += [f"{document['skipped']} missed cycles"] if document["skipped"] else []
    if difference is None:
        click.echo(f"{counted}: every voltage equal, bit for bit" + (f" ({', '.join(met)})" if met else ""))
    else:
        click.echo(f"{counted} equal; cycle {difference['cycle']}, {difference['t_s']:.4f} s, differs:")
        for value in difference["values"]:
            name = f"{value['name']}_{value['axis']}" if value["axis"] else value["name"]
            click.echo(f"  {name}: recorded {value['recorded']!r}, replayed {value['replayed']!r}")
        click.echo(f"probably: {difference['cause']}")
    for gap in document["gaps"]:
        click.echo(f"gap: {gap}")
    if document["left_out"]:
        click.echo(f"{document['left_out']} rows could not be replayed: no state of the loop is at hand before them")
    if document["lacks"]:
        click.echo(f"an older version recorded it; its rows do not say: {', '.join(document['lacks'])}")
