"""``micromanip sweep RECORDING...``: thousands of drawn tunings on what was recorded, and the best of them."""

from __future__ import annotations

import datetime
import pickle
import tempfile
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from micromanip.errors import UsageError

from .options import Quantity, StrictCommand, json_option, print_answer
from .prose import say
from .recording_options import Cut
from .results import keep, require_room

if TYPE_CHECKING:
    from micromanip.design.sweep.space import Space
    from micromanip.design.sweep.trial import Trials
    from micromanip.design.sweep.work import Tried

_DATABASE = b"SQLite format 3\0"


@click.command(
    "sweep",
    cls=StrictCommand,
    epilog="Example: micromanip sweep out/run.mcap --cut 6:7 --vary axes.*.outer.control_weight=1:100:log "
    "--number 1000 --out out/sweep.sqlite --best out/best.yaml",
)
@click.argument("files", type=click.Path(path_type=Path), metavar="RECORDING...", nargs=-1, required=True)
@click.option(
    "--vary", "varied", multiple=True, metavar="KEY=LOW:HIGH[:log]",
    help="A key to draw, and between what; axes.*. is every axis alike. Again for more keys.",
)  # fmt: skip
@click.option(
    "--space", "space_file", type=click.Path(path_type=Path), metavar="FILE.yaml",
    help="The same as a file: vary: {KEY: {low: 1, high: 100, log: true}}; with --vary, both.",
)  # fmt: skip
@click.option(
    "--config", type=click.Path(path_type=Path), help="Tuning that is varied.  [default: that of the first recording]"
)
@click.option("--number", type=click.IntRange(1, 10_000_000), default=1000, show_default=True, help="Tunings to draw.")
@click.option("--seed", type=Quantity("Seed"), default=1, show_default=True, help="Seed of what is drawn.")
@click.option("--cut", type=Cut(), help="This part of each recording only, in seconds from its first row.")
@click.option(
    "--out", "--to", "out", type=click.Path(path_type=Path, dir_okay=False), required=True,
    help="SQLite file of the results; where it is there, what it lacks is tried.",
)  # fmt: skip
@click.option("--best", type=click.Path(path_type=Path, dir_okay=False), help="File for the keys of the best tuning.")
@click.option(
    "--table", type=click.Path(path_type=Path, dir_okay=False), help="New file for all results, .csv or .parquet."
)
@click.option("--top", type=click.IntRange(1, 1000), default=5, show_default=True, help="How many are shown.")
@click.option(
    "--jobs", type=click.IntRange(-1, 1024), default=-1, show_default="one a CPU", help="Processes that share the work."
)
@click.option("--cluster", "address", help="Dask scheduler that takes the work instead, e.g. tcp://host:8786.")
@json_option
def command(
    files: tuple[Path, ...], varied: tuple[str, ...], space_file: Path | None, config: Path | None, number: int,
    seed: int, cut: tuple[float, float] | None, out: Path, best: Path | None, table: Path | None, top: int, jobs: int,
    address: str | None, as_json: bool,
) -> None:  # fmt: skip
    """Draw tunings, try each on recordings as `replay --with` does, and list those that hold the path best.

    Each is in force from the beginning of a recording's tracking, or of --cut. Tuning 0 is the one that is varied. The
    results follow from the seed and the number alone, also where workers are killed; begun again, a sweep goes on.
    """
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    from micromanip.design.sweep.running import run_trials
    from micromanip.design.sweep.sharing import on_cluster, on_processes
    from micromanip.design.sweep.space import Dimension, Space, read_dimensions
    from micromanip.design.sweep.store import Store
    from micromanip.design.sweep.work import Work
    from micromanip.rt.jit import Compiler

    Compiler.tell = staticmethod(lambda name: say(f"compiling {name} (the first time only)", err=True))
    if not varied and space_file is None:
        raise UsageError("nothing is varied: give --vary KEY=LOW:HIGH, or --space FILE.yaml")
    dimensions = () if space_file is None else read_dimensions(space_file)
    space = Space((*dimensions, *(Dimension.parse(text) for text in varied)), seed)
    if table is not None:
        _require_table(table)
    for place in (each for each in (out, best, table) if each is not None):
        require_room(place.parent, str(place))
    _require_results(out)
    trials, about = _prepare(files, config, space, cut)
    about |= {"vary": [str(each) for each in space.dimensions], "seed": seed, "cut": None if cut is None else list(cut)}
    axes = list(trials.base.configuration.axes)
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with (
        Store(out, about, [each.key for each in space.dimensions], axes) as store,
        tempfile.TemporaryDirectory(prefix="micromanip-") as folder,
        Progress(*columns, console=Console(stderr=True), transient=True) as bar,
    ):
        content, name = pickle.dumps(trials), f"{folder}"
        file = Path(folder) / "trials.pickle"
        if address is None:
            file.write_bytes(content)
        work = Work(name, file) if address is None else Work(name, content=content)
        trials.tried(0)  # compiles what the workers then load
        task = bar.add_task("tunings", total=number + 1, completed=number + 1 - len(store.missing(number)))
        share = on_processes(jobs) if address is None else on_cluster(address)
        run_trials(store, work, number, share, lambda count: bar.advance(task, count))
        found, base, counts = store.best(top), store.one(0), store.counts()
        if table is not None:
            keep(store.write_table, table)
    judged = [(each, _judged(trials, each)) for each in found]
    good = next((each for each, problem in judged if problem is None), None)
    good = None if good is None or good.number == 0 else good
    document = {
        "files": list(map(str, files)),
        "out": str(out),
        "seed": seed,
        "number": number,
        **counts,
        "axes": axes,
        "base": _told(base, None, axes),
        "best": [_told(each, problem, axes) for each, problem in judged],
        "written": None if best is None or good is None else str(best),
        "table": None if table is None else str(table),
    }
    if best is not None and good is not None:
        keep(partial(_write, text=_fragment(trials, space, good, base, document)), best)
    print_answer(document, _show, as_json)
    if best is not None and good is None:
        from micromanip.errors import CheckFailed

        raise CheckFailed(f"{best} is not written: none of the best {len(found)} that passes the check beats tuning 0")


def _require_results(out: Path) -> None:
    """What is in it is looked at later; what is no database is refused before anything is read or compiled."""
    if out.is_file() and _head(out) not in (b"", _DATABASE):
        raise UsageError(f"--out {out} is no file of a sweep; give another name")


def _head(file: Path) -> bytes:
    with file.open("rb") as opened:
        return opened.read(len(_DATABASE))


def _require_table(table: Path) -> None:
    if table.suffix.lower() not in (".csv", ".parquet"):
        raise UsageError(f"--table {table}: its ending is .csv or .parquet")
    if table.exists():
        raise UsageError(f"{table} is there already: nothing is replaced; give another name")


def _prepare(
    files: tuple[Path, ...], config: Path | None, space: Space, cut: tuple[float, float] | None
) -> tuple[Trials, dict[str, Any]]:
    """What is tried, and what tells this sweep from others."""
    from micromanip.design.sweep.trial import Trials, require_keys
    from micromanip.recordings import open_telemetry
    from micromanip.replay.comparable import recorded_configuration, require_comparable
    from micromanip.replay.fitting import fit_models
    from micromanip.replay.window import take_window
    from micromanip.settings.text.source import Source

    recordings = [open_telemetry(file) for file in files]
    of_files = [recorded_configuration(telemetry) for telemetry in recordings]
    source = of_files[0][0] if config is None else Source.read(config)
    trials = Trials(source, space, [])
    for telemetry, (_, recorded) in zip(recordings, of_files, strict=True):
        require_comparable(recorded, trials.base.configuration, telemetry.file, source.path)
    require_keys(trials)
    for telemetry, (_, recorded) in zip(recordings, of_files, strict=True):
        window = take_window(telemetry, cut, arming=False)
        trials.pieces.append((window, fit_models(window, recorded)))
    first = [int(window.rows["cycle"][0]) for window, _ in trials.pieces]
    sizes = [len(window.rows) for window, _ in trials.pieces]
    named = [[telemetry.sha256[:16], *piece] for telemetry, *piece in zip(recordings, first, sizes, strict=True)]
    return Trials(source, space, trials.pieces), {"tuning": source.hash[:16], "recordings": named}


def _judged(trials: Trials, tried: Tried) -> str | None:
    """Why the whole check of a configuration refuses the tuning; None where it does not."""
    from micromanip.errors import ConfigError
    from micromanip.settings.check import revise, validate

    source = trials.tuned(tried.number)
    try:
        revise(trials.base, validate(source), source)
    except ConfigError as problem:
        return str(problem).partition("\n")[0]
    return None


def _told(tried: Tried, problem: str | None, axes: list[str]) -> dict[str, Any]:
    figures = {
        axis: {"rms_um": tried.rms_um[i], "p99_um": tried.p99_um[i], "peak_um": tried.peak_um[i]}
        for i, axis in enumerate(axes if tried.cost_um is not None else [])
    }
    told = {"number": tried.number, "cost_um": tried.cost_um, "values": tried.values, "errors": figures}
    return told | {"stopped": tried.stopped, "problem": tried.problem or problem}


def _fragment(trials: Trials, space: Space, best: Tried, base: Tried, document: dict[str, Any]) -> str:
    """The keys of a tuning as YAML, under a heading that says where they come from."""
    import yaml

    from micromanip.design.sweep.space import for_axes

    nested: dict[str, Any] = {}
    for key, value in for_axes(best.values, document["axes"]).items():
        place = nested
        *sections, last = key.split(".")
        for section in sections:
            place = place.setdefault(section, {})
        place[last] = value
    today = datetime.datetime.now(datetime.UTC).date().isoformat()
    was = "the cell stops with the tuning as it was" if base.cost_um is None else f"{base.cost_um:.4f} um as it was"
    heading = [
        f"A part of a configuration, no whole one: tuning {best.number} of {document['number']} drawn by",
        f"micromanip sweep on {today}, seed {space.seed}: {', '.join(map(str, space.dimensions))};",
        f"all else is that of {trials.source.path} ({trials.source.hash[:8]}).",
        f"Predicted path error on {', '.join(document['files'])}:",
        f"{best.cost_um:.4f} um rms over all axes, {was}. Neither commissioned nor run: try it with",
        "micromanip analyse and micromanip replay --with, then shadow and promote.",
    ]
    return "".join(f"# {line}\n" for line in heading) + str(yaml.safe_dump(nested, sort_keys=False))


def _write(file: Path, text: str) -> None:
    file.write_text(text, encoding="utf-8")


def _show(document: dict[str, Any]) -> None:
    from rich.text import Text

    from .tables import Figures, out_console

    console = out_console()
    keys = list(dict.fromkeys(key for each in document["best"] for key in each["values"]))
    table = Figures(title="Path error, um rms")
    for heading in ("tuning", "all axes", *document["axes"], *keys, "check"):
        table.add_column(heading, justify="right")
    for each in [document["base"], *(best for best in document["best"] if best["number"] != 0)]:
        rms = [f"{each['errors'][axis]['rms_um']:.4f}" if each["errors"] else "-" for axis in document["axes"]]
        values = [f"{each['values'][key]:.4g}" if key in each["values"] else "as it is" for key in keys]
        cost = "stops" if each["cost_um"] is None else f"{each['cost_um']:.4f}"
        table.add_row(str(each["number"]), cost, *rms, *values, each["problem"] or "passes")
    console.print(table)
    console.print(
        Text(
            f"{document['tried']} tried, {document['refused']} refused, {document['stopped']} would stop the cell; "
            f"in {document['out']}"
        )
    )
    if document["written"]:
        console.print(Text(f"the best that passes is in {document['written']}"))
