"""``micromanip system check``: whether this machine keeps a loop's deadlines, and what keeps it from that."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from .echo import echo
from .options import Quantity, emit_answer, subcommand

if TYPE_CHECKING:
    from micromanip.host.readiness.answer import Answer
    from micromanip.host.readiness.loop_run import LoopRun
    from micromanip.settings.schema.model import Loop

_STYLES = {"good": "green", "poor": "yellow", "bad": "bold red", "unknown": "dim"}


@subcommand("check", "sudo micromanip system check config/simulated.yaml")
@click.argument("config", type=click.Path(path_type=Path), metavar="[CONFIG]", required=False)
@click.option("--seconds", type=Quantity("Seconds", least=1, most=3600), default=5.0,
              help="Length of each of the two runs.")  # fmt: skip
@click.option("--no-run", is_flag=True, help="Look at the settings only; nothing is run.")
def command(config: Path | None, seconds: float, no_run: bool, as_json: bool) -> None:
    """Say whether this machine keeps the deadlines of the loop of CONFIG, and what would mend what does not.

    Without CONFIG: a loop at 10 kHz on the last CPU, with the limits of hardware. The loop is run with a simulated cell
    in READY, at rest and beside busy processes, whatever drivers CONFIG names: no device is opened.

    Ends with 1 where the machine is not ready for hardware. It refuses to run beside a controller.
    """
    from micromanip.host.readiness.answer import Answer, looked_at, machine_and_loop
    from micromanip.host.readiness.finding import Machine
    from micromanip.host.readiness.timed import measure

    (loop, interfaces), machine = _loop(config), Machine()
    findings, timed = looked_at(machine, loop, interfaces), None
    if not no_run and not any(finding.name == "loop's CPU" and finding.verdict == "bad" for finding in findings):
        timed = measure(loop, seconds, lambda line: echo(line, err=True))
    answer = Answer(machine_and_loop(machine, loop), findings, timed)
    emit_answer(answer.document(), lambda _: _show(answer), as_json)
    if answer.ready is False:
        raise SystemExit(1)


def _loop(config: Path | None) -> tuple[Loop, list[str]]:
    """The loop, and the network interfaces at which it serves EtherCAT itself."""
    import os

    from micromanip.settings.schema.model import Loop

    if config is None:
        return Loop(cpu=max(os.sched_getaffinity(0)), limits="hardware"), []
    from micromanip.settings.check import prepare

    prepared = prepare(config)
    named = (device.partition(" ") for device in sorted(prepared.wiring.devices))
    return prepared.configuration.loop, [interface for kind, _, interface in named if kind == "ethercat"]


def _show(answer: Answer) -> None:
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
