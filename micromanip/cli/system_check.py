"""``micromanip system check``: whether this machine keeps a loop's deadlines, and what keeps it from that."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from micromanip.errors import UsageError

from .echo import echo
from .options import Quantity, emit_answer, subcommand

if TYPE_CHECKING:
    from micromanip.host.readiness.answer import Answer
    from micromanip.host.readiness.timed import Condition
    from micromanip.settings.schema.model import Loop

_STYLES = {"good": "green", "poor": "yellow", "bad": "bold red", "unknown": "dim"}


@subcommand("check", "sudo micromanip system check config/simulated.yaml")
@click.argument("config", type=click.Path(path_type=Path), metavar="[CONFIG]", required=False)
@click.option("--seconds", type=Quantity("Seconds", least=1, most=3600), default=5.0,
              help="Length of each of the six runs.")  # fmt: skip
@click.option("--no-run", is_flag=True, help="Look at the settings only; nothing is run.")
def command(config: Path | None, seconds: float, no_run: bool, as_json: bool) -> None:
    """Say whether this machine keeps the deadlines of the loop of CONFIG, and what would mend what does not.

    Without CONFIG: a loop at 10 kHz on the last CPU, with the limits of hardware. The loop is run with a simulated cell
    in READY, at rest and beside busy processes, whatever drivers CONFIG names: no device is opened. cyclictest (Debian
    package rt-tests) runs in turns with it. As root, the kernel's trace says what made the loop late.

    Ends with 1 where the machine is not ready for hardware. It refuses to run beside a controller.
    """
    from micromanip.host.readiness.answer import Answer, looked_at, machine_and_loop
    from micromanip.host.readiness.finding import Machine
    from micromanip.host.readiness.timed import measure

    (loop, interfaces), machine = _loop(config), Machine()
    findings, timed = looked_at(machine, loop, interfaces), None
    if not no_run:
        if loop.cpu is None:
            raise UsageError("loop.cpu is null: there is no CPU to watch; name one in CONFIG, or give --no-run")
        if not any(finding.name == "loop's CPU" and finding.verdict == "bad" for finding in findings):
            timed = measure(loop, loop.cpu, seconds, lambda line: echo(line, err=True))
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
    from .tables import Figures, out_console

    console = out_console()
    table = Figures("setting", "", "found")
    for finding in answer.findings:
        style = _STYLES[finding.verdict]
        table.add_row(finding.name, f"[{style}]{finding.verdict}[/]", _plain(finding.found))
    console.print(table)
    for finding in answer.findings:
        if finding.mend is not None:
            console.print(f"[bold]{finding.name}[/]: {_plain(finding.why)}\n  {_plain(finding.mend)}")
    if answer.timed is not None:
        timed = answer.timed
        table = Figures("us", "p50", "p99", "p99.9", "p99.99", "max", "overruns")
        for name, condition in (("at rest", timed.at_rest), ("under load", timed.under_load)):
            for row in _rows(name, condition):
                table.add_row(*row)
        console.print(table)
        for line in timing_lines(timed.document()):
            console.print(_plain(line))
    style = {True: "bold green", False: "bold red", None: "bold yellow"}[answer.ready]
    console.print(f"[{style}]{_plain(answer.verdict)}[/]")


def _rows(name: str, condition: Condition) -> list[tuple[str, ...]]:
    from micromanip.host.readiness.timed import condition_document

    document = condition_document(condition)
    rows = []
    for what, overruns in (("lateness", str(document["overruns"])), ("compute", ""), ("cyclictest", "")):
        if (figures := document[f"{what}_ns"]) is not None:
            rows.append((f"{what}, {name}", *(f"{value / 1e3:.1f}" for value in figures.values()), overruns))
    return rows


def timing_lines(timed: dict[str, Any]) -> list[str]:
    """What was counted, what made the loop late, and what could not be measured; a line each."""
    lines = []
    if gaps := timed["clock_gaps"]:
        lines.append(
            f"A process that only watches the clock on that CPU missed it {gaps['per_s']:g} times per second, "
            f"{gaps['share']:.2%} of the time, {gaps['max_ns'] / 1e3:.0f} us at most."
        )
    counted = [f"{name}: {value}" for name, value in timed["counters_under_load"].items()]
    interrupts = sorted(timed["interrupts_under_load"].items(), key=lambda each: -each[1])
    counted += [f"{name}: {count}" for name, count in interrupts[:_INTERRUPTS]]
    lines.append(f"Counted under load: {'; '.join(counted)}.")
    for late in timed["late_cycles"]:
        causes = ", ".join(f"{us} us {cause}" for cause, us in late["causes"][:_CAUSES])
        lines.append(f"{late['lateness_us']:.0f} us late: {causes or 'less than the trace can resolve'}.")
    lines += [f"Not measured: {reason}" for reason in timed["not_measured"]]
    return lines


_CAUSES, _INTERRUPTS = 3, 5


def _plain(text: str) -> str:
    from rich.markup import escape

    return escape(text)
