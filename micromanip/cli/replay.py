"""``micromanip replay RECORDING``: a recorded run again, bit for bit, or under other tunings."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from micromanip.errors import UsageError

from .echo import echo
from .options import Answer, Quantity, subcommand
from .progress import show_compiling
from .recording_options import Cut, open_recording

_OF_VARY = ("trials", "best", "objective", "seed", "jobs", "address", "to")


@subcommand("replay", "micromanip replay out/run.mcap --vary axes.*.outer.control_weight=1..100:log --to best.yaml")
@click.argument("file", type=click.Path(path_type=Path), metavar="RECORDING")
@click.option(
    "--with",
    "config",
    type=click.Path(path_type=Path),
    metavar="CONFIG",
    help="Another tuning of the same cell: predict its path error, and the limits it would meet.",
)
@click.option(
    "--vary", multiple=True, metavar="KEY=A..B",
    help="A number of the recorded tuning, or of CONFIG, to vary: A..B, A..B:log, or a list A,B,C. axes.*. is every "
    "axis alike. Again for more keys.",
)  # fmt: skip
@click.option("--cut", type=Cut(), help="With --with or --vary: this part only, in seconds from the first row.")
@click.option("--trials", type=click.IntRange(1, 1_000_000), default=200, help="With --vary: tunings to try.")
@click.option("--best", type=click.IntRange(1, 1000), default=5, help="With --vary: tunings shown.")
@click.option(
    "--objective", type=click.Choice(["rms", "p99", "peak"]), default="rms",
    help="With --vary: the figure of the path error, over all axes, by which tunings are ranked.",
)  # fmt: skip
@click.option("--seed", type=Quantity("Seed"), default=1, help="With --vary: seed of the trials.")
@click.option("--jobs", type=click.IntRange(1, 1024), show_default="one a CPU", help="With --vary: processes.")
@click.option(
    "--scheduler", "address", metavar="ADDRESS", help="With --vary: a Dask scheduler instead, e.g. tcp://host:8786."
)
@click.option(
    "--to", type=click.Path(path_type=Path, dir_okay=False), help="With --vary: new file for the best configuration."
)
@click.pass_context
def command(
    context: click.Context, /, file: Path, config: Path | None, vary: tuple[str, ...], cut: tuple[float, float] | None,
    **search: Any,
) -> Answer:  # fmt: skip
    """Run the cycles of a recording once more on what came in, and compare each number bit for bit.

    Voltages, set-points, estimates, feedforward, feedback, states and faults. Exit code 0 where all are equal, 1 where
    one is not: the first is shown, with what probably made it differ.

    With --with the same forces, noise and path meet another tuning: from the arming on where that is recorded, else
    from the beginning, or that of --cut. Exit code 1 where the cell would have stopped.

    With --vary many tunings are tried like that, from the beginning of tracking on, and the best are listed. --to
    takes the best that passes `check`; exit code 1 where none is better.
    """
    if not vary and (name := next((name for name in _OF_VARY if _is_given(context, name)), None)):
        raise UsageError(f"--{'scheduler' if name == 'address' else name} goes with --vary")
    if vary:
        from .variation_report import vary_tuning

        return vary_tuning(file, config, cut, vary=vary, **search)
    if config is not None:
        from .counterfactual_report import predict_tuning

        return predict_tuning(file, config, cut)
    if cut is not None:
        raise UsageError("--cut goes with --with or --vary; without them the whole recording is compared")
    from micromanip.replay import replay

    show_compiling()
    telemetry = open_recording(file)
    found = replay(telemetry)
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
    return Answer(document, lambda: _show(document), None if difference is None else SystemExit(1))


def _is_given(context: click.Context, name: str) -> bool:
    return context.get_parameter_source(name) not in (None, click.core.ParameterSource.DEFAULT)


def _show(document: dict[str, Any]) -> None:
    difference, axes = document["difference"], len(document["axes"])
    counted = f"{document['cycles']} cycles, {axes} {'axis' if axes == 1 else 'axes'}"
    met = [f"{count} x {name}" for name, count in document["commands"].items()]
    met += [f"{document['swaps']} changes of parameters"] if document["swaps"] else []
    met += [f"{document['skipped']} missed cycles"] if document["skipped"] else []
    if difference is None:
        echo(f"{counted}: every voltage equal, bit for bit" + (f" ({', '.join(met)})" if met else ""))
    else:
        echo(f"{counted} equal; cycle {difference['cycle']}, {difference['t_s']:.4f} s, differs:")
        for value in difference["values"]:
            name = f"{value['name']}_{value['axis']}" if value["axis"] else value["name"]
            echo(f"  {name}: recorded {value['recorded']!r}, replayed {value['replayed']!r}")
        echo(f"probably: {difference['cause']}")
    for gap in document["gaps"]:
        echo(f"gap: {gap}")
    if document["left_out"]:
        echo(f"{document['left_out']} rows could not be replayed: no state of the loop is at hand before them")
