"""``micromanip system check``, ``install``, ``bench``: this machine as a controller, its service, its speed."""

from __future__ import annotations

import importlib
import os
import sys
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

import micromanip
from micromanip.errors import CheckFailed, DeviceUnavailable, MicromanipError, UsageError

from .echo import echo
from .options import Answer, Quantity, subcommand, wants_json, warn
from .progress import steps

if TYPE_CHECKING:
    from micromanip.host.readiness import answer as readiness
    from micromanip.host.readiness.loop_run import LoopRun
    from micromanip.settings.schema.model import Loop

_STYLES = {"good": "green", "poor": "yellow", "bad": "bold red", "unknown": "dim"}


@subcommand("check", "sudo micromanip system check config/simulated.yaml")
@click.argument("config", type=click.Path(path_type=Path), metavar="[CONFIG]", required=False)
@click.option("--seconds", type=Quantity("Seconds", least=1, most=3600), default=5.0,
              help="Length of each of the two runs.")  # fmt: skip
@click.option("--no-run", is_flag=True, help="Look at the settings only; nothing is run.")
def check(config: Path | None, seconds: float, no_run: bool) -> Answer:
    """Say whether this machine keeps the deadlines of the loop of CONFIG, and what would mend what does not.

    Without CONFIG: a loop at 10 kHz on the last CPU, with the limits of hardware. The loop is run with a simulated cell
    in READY, at rest and beside busy processes, whatever drivers CONFIG names: no device is opened.

    Ends with 1 where the machine is not ready for hardware. It refuses to run beside a controller.
    """
    from micromanip.host.readiness import answer as readiness
    from micromanip.host.readiness.finding import Machine
    from micromanip.host.readiness.timed import measure

    (loop, interfaces), machine = _loop(config), Machine()
    findings, timed = readiness.looked_at(machine, loop, interfaces), None
    if not no_run and not any(finding.name == "loop's CPU" and finding.verdict == "bad" for finding in findings):
        timed = measure(loop, seconds, lambda line: echo(line, err=True))
    found = readiness.Answer(readiness.machine_and_loop(machine, loop), findings, timed)
    return Answer(found.document(), lambda: _show(found), SystemExit(1) if found.ready is False else None)


def _loop(config: Path | None) -> tuple[Loop, list[str]]:
    """The loop, and the network interfaces at which it serves EtherCAT itself."""
    from micromanip.settings.schema.model import Loop

    if config is None:
        return Loop(cpu=max(os.sched_getaffinity(0)), limits="hardware"), []
    from micromanip.settings.check import prepare

    prepared = prepare(config)
    named = (device.partition(" ") for device in sorted(prepared.wiring.devices))
    return prepared.configuration.loop, [interface for kind, _, interface in named if kind == "ethercat"]


def _show(answer: readiness.Answer) -> None:
    from .tables import out_console, print_table

    console = out_console()
    rows = [(each.name, f"[{_STYLES[each.verdict]}]{each.verdict}[/]", _plain(each.found)) for each in answer.findings]
    print_table(("setting", "", "found"), rows)
    for finding in answer.findings:
        if finding.mend is not None:
            console.print(f"[bold]{finding.name}[/]: {_plain(finding.why)}\n  {_plain(finding.mend)}")
    if answer.timed is not None:
        timed = answer.timed
        timings = [*_rows("at rest", timed.at_rest), *_rows("under load", timed.under_load)]
        print_table(("us", "p50", "p99", "p99.9", "p99.99", "max", "overruns"), timings)
    style = {True: "bold green", False: "bold red", None: "bold yellow"}[answer.ready]
    console.print(f"[{style}]{_plain(answer.verdict)}[/]")


def _rows(name: str, run: LoopRun) -> list[tuple[str, ...]]:
    document = run.document()
    return [
        (f"{what}, {name}", *(f"{value / 1e3:.1f}" for value in document[f"{what}_ns"].values()), overruns)
        for what, overruns in (("lateness", str(document["overruns"])), ("compute", ""))
    ]


def _plain(text: str) -> str:
    from rich.markup import escape

    return escape(text)


@subcommand("install", "sudo micromanip system install cell.yaml --dry-run")
@click.argument("config", type=click.Path(path_type=Path), required=False)
@click.option(
    "--dry-run", is_flag=True, help="Only show what would be done, with contents and differences, from anywhere."
)
@click.option("--yes", is_flag=True, help="Don't ask.")
@click.option("--uninstall", is_flag=True, help="Stop and remove the service; configuration and state stay.")
@click.option("--purge", is_flag=True, help="With --uninstall: remove configuration, state and user too.")
@click.option(
    "--root",
    type=click.Path(path_type=Path, file_okay=False, exists=True, resolve_path=True),
    default="/",
    help="Install below this folder, e.g. another machine's file system.",
)
def install(config: Path | None, dry_run: bool, yes: bool, uninstall: bool, purge: bool, root: Path) -> Answer:
    """Run CONFIG as a service of systemd: it is copied to /etc/micromanip/cell.yaml.

    Without CONFIG the one that is there is kept. What is installed already is left alone, so it may be repeated.
    """
    from micromanip.host.service import layout, plan

    if purge and not uninstall:
        raise UsageError("--purge goes with --uninstall")
    if uninstall and config is not None:
        raise UsageError("--uninstall takes no CONFIG")
    warnings: list[str] = []

    def in_the_way(problem: MicromanipError) -> None:
        if not dry_run:
            raise problem
        warnings.append(f"it can't be installed like this: {problem}")

    machine = layout.this_machine(in_the_way)
    if uninstall:
        planned = plan.uninstall(machine, root, purge=purge)
    else:
        planned = plan.install(machine, config, root, warnings.append)
    warn(warnings)
    described = [{"step": step.sentence, "diff": list(step.diff)} for step in planned]
    done = bool(planned) and not dry_run
    if not wants_json():
        _show_steps(described)
    if done:
        if not yes:
            _ask()
        plan.carry_out(planned, root, lambda line: echo(line, err=True))
    said = "removed" if uninstall else f"installed; `systemctl restart {layout.UNIT}` puts it in force"
    document = {"steps": described, "done": done, "warnings": warnings}
    return Answer(document, lambda: echo(said) if done else None)


def _ask() -> None:
    if not sys.stdin.isatty():
        raise UsageError("nobody is there to ask; add --yes to do it, or --dry-run to see it only")
    click.confirm("Do this?", abort=True, err=True)


def _show_steps(steps: list[dict[str, Any]]) -> None:
    if not steps:
        echo("nothing to do: all is as it should be")
    for step in steps:
        echo(step["step"])
        for line in step["diff"]:
            click.echo(f"    {line}")  # of a file: as it is


@subcommand("bench", "micromanip system bench --only cycle --only offline")
@click.option("--only", multiple=True, metavar="NAME", help="One of the names below; may be repeated.")
def bench(only: tuple[str, ...]) -> Answer:
    """Measure the speed of this machine, each figure beside a reference measured in the same run.

    cycle: three axes beside the same cycle in plain C, in a warm cache and (cycle_cold) behind a neighbour that empties
    it, and (cycle_laws) with every law switched on, beside the configuration as it is.
    lateness: wake-ups of the loop process beside cyclictest.
    offline: simulation beside real time. startup: command to READY, and memory, beside Python's own.
    exchange: on each bus in operation, rate and age of its fastest signal, and the processor time of its worker, beside
    what is stated and the loop.

    Where the machine lacks what one of them needs (gcc, cyclictest, rights), that is said and it is skipped. Ends with
    1 where one finds the controller itself wrong; the others are measured all the same.
    """
    find_source_tree()
    runner = importlib.import_module("benchmarks.runner")
    with steps() as bar:
        tell = bar.say if bar.console.is_terminal else partial(echo, err=True)
        document = runner.run(tell, only)
    failed = CheckFailed(f"failed, as said above: {', '.join(row['name'] for row in document['failed'])}")
    return Answer(document, lambda: _table(document), failed if document["failed"] else None)


def find_source_tree() -> None:
    """Make the package `benchmarks` importable; raises DeviceUnavailable where there is none."""
    assert micromanip.__file__ is not None
    root = Path(micromanip.__file__).parent.parent
    if not (root / "benchmarks" / "runner.py").is_file():
        raise DeviceUnavailable("system bench needs the source tree of micromanip, which this installation lacks")
    if str(root) not in sys.path:
        sys.path.insert(0, str(root))


def _table(document: dict[str, Any]) -> None:
    from .tables import print_table

    rows = []
    for row in document["results"]:
        value, reference = (f"{row[key]:g} {row['unit']}" for key in ("value", "reference_value"))
        rows.append((row["name"], value, row["reference_name"], reference, f"{row['ratio']:g}"))
    for outcome in ("skipped", "failed"):
        rows += [(row["name"], outcome, row["reason"], "", "") for row in document[outcome]]
    print_table(("figure", "value", "reference", "", "ratio"), rows)
