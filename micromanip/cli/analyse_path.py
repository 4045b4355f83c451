"""``micromanip analyse path``: whether the stage reaches a path, before a part is mounted."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from micromanip.errors import CheckFailed, MicromanipError

from .echo import echo
from .options import Answer, Quantity, axis_option, chosen_axes, subcommand, warn
from .results import out_option, page_in

if TYPE_CHECKING:
    from collections.abc import Sequence

    from micromanip.design.analyse.path.preview import AxisPreview, Preview, Stretch

_MOST_SHOWN = 24


@subcommand("path", "micromanip analyse path path.csv --config config/simulated.yaml")
@click.argument("file", type=click.Path(path_type=Path), metavar="PATH")
@click.option("--config", type=click.Path(path_type=Path), metavar="CONFIG", required=True, help="The cell.")
@axis_option
@click.option(
    "--reserve", "reserve_um", type=Quantity("DistanceOrZero"), default=3.0, metavar="UM",
    help="Kept at each end of the set-point's range, and as much of the voltage's, for force, creep and noise.",
)  # fmt: skip
@click.option(
    "--tolerance", "tolerance_um", type=Quantity("Distance"), metavar="UM",
    help="Following error that is tolerated.  [default: 3 times the axis' accept.tracking_error_um, else 5]",
)  # fmt: skip
@out_option("the page path.html")
def command(
    file: Path, config: Path, only: str, reserve_um: float, tolerance_um: float | None, folder: Path | None,
) -> Answer:  # fmt: skip
    """Which stretches of PATH ask for more than the stage has; exit code 1 where one does.

    PATH is a table of the robot's deviation (t_s, deviation_<axis>_um), or a recording: what the tracker saw in it.
    docs/analyse.md explains it.
    """
    from micromanip.design.analyse.path.preview import preview_of
    from micromanip.design.analyse.path.seen import seen_path
    from micromanip.settings.check import prepare

    prepared = prepare(config)
    chosen = chosen_axes(prepared.configuration.axes, only, config)
    path = seen_path(file, chosen)
    with page_in(folder, "path.html") as page:
        found = preview_of(prepared, path, reserve_um, tolerance_um)
        if folder is not None:
            from micromanip.design.plots.findings import preview_sections

            page.write(f"Path {file}", preview_sections(found, prepared.configuration.axes, f"{file}, {config}"))
    over = sorted((stretch for axis in found.axes for stretch in axis.stretches), key=lambda each: each.from_s)

    def show() -> None:
        warn(found.notes)
        _print(found, over)
        page.echo()

    problem: MicromanipError | None = page.problem
    if problem is None and over:
        problem = CheckFailed(
            f"{file} does not fit: {len(over)} stretches ask for more than there is, the first: axis {over[0].axis}, "
            f"{over[0].what}, at {over[0].from_s:.2f} s"
        )
    document = {"path": str(file), "config": str(config), "reserve_um": reserve_um, **found.document()}
    return Answer(document | {"page": page.name}, show, problem)


def _print(found: Preview, over: Sequence[Stretch]) -> None:
    from .tables import print_table

    print_table(
        ("axis", "deviation, um", "set-point, um", "voltage, V", "error rms, um", "peak, um", "verdict"),
        map(_row, found.axes),
        f"Path of {found.seconds:.1f} s",
    )
    rows = (
        (
            f"{each.from_s:.2f}", f"{each.to_s:.2f}", each.axis, each.what, f"{each.asked:.4g}", f"{each.limit:.4g}",
            f"{each.over:.3g} {each.unit}",
        )
        for each in over[:_MOST_SHOWN]
    )  # fmt: skip
    print_table(("from, s", "to, s", "axis", "what", "asked", "limit", "over"), rows, "More than there is")
    if len(over) > _MOST_SHOWN:
        echo(f"and {len(over) - _MOST_SHOWN} more: --json has them all")


def _row(axis: AxisPreview) -> list[str]:
    told = axis.document()
    ends = ["{:.1f} .. {:.1f}".format(*told[key]) if told[key] else "-" for key in (
        "deviation_um", "setpoint_um", "voltage_V")]  # fmt: skip
    error = told["error_um"]
    over = len(axis.stretches)
    verdict = "[green]fits[/]" if not over else f"[red]{over} stretch{'es' if over > 1 else ''} over[/]"
    return [axis.axis, *ends, f"{error['rms']:.3f}", f"{error['peak']:.2f}", verdict]
