"""``micromanip candidate set``, ``show``, ``promote``, ``discard``: a tuning beside the one that runs."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

import click

from micromanip.client import Client
from micromanip.errors import CheckFailed
from micromanip.replies import Candidate

from .echo import echo
from .options import Answer, client_command, socket_option, subcommand
from .parameters import echo_changes


def _show(candidate: Candidate) -> None:
    """Standing, what it changes, and its figures so far."""
    echo(_standing_line(candidate))
    echo_changes(candidate["changed"])
    if candidate["reason"]:
        echo(candidate["reason"])
    from .tables import print_table

    print_table(("axis", "innovation, um", "feedback, V"), _comparison(candidate), "rms: active -> candidate")
    print_table(("axis", "before", "on trial", "limit"), _trial(candidate), "Error rms, um")


def _standing_line(candidate: Candidate) -> str:
    """One line: the candidate's version, where it stands, and how much of its trial is over."""
    if candidate["version"] is None:
        return "there is no candidate"
    line = f"candidate, parameter version {candidate['version']}: {candidate['standing']}"
    if candidate["passed_s"] is not None and candidate["trial_s"] is not None:
        passed_s = min(candidate["passed_s"], candidate["trial_s"])
        line += f", {passed_s:.1f} of {candidate['trial_s']:g} s"
    return line


def _comparison(candidate: Candidate) -> Iterator[tuple[str, ...]]:
    for axis, figures in candidate["comparison"].items():
        active, other = figures["active"], figures["candidate"]
        innovation = _pair(active["innovation_um"], other["innovation_um"])
        yield axis, innovation, _pair(active["feedback_V"], other["feedback_V"])


def _trial(candidate: Candidate) -> Iterator[tuple[str, ...]]:
    for axis, error in candidate["trial"].items():
        yield axis, _number(error["before_um"]), _number(error["now_um"]), _number(error["limit_um"])


def _pair(active: float | None, candidate: float | None) -> str:
    return "-" if active is None and candidate is None else f"{_number(active)} -> {_number(candidate)}"


def _number(value: float | None) -> str:
    return "-" if value is None else f"{value:.3f}"


@subcommand("set", "micromanip candidate set axes.x.outer.control_weight=12")
@click.argument("assignments", nargs=-1, required=True, metavar="KEY=VALUE...")
@client_command(_show)
def set_(assignments: tuple[str, ...]) -> Callable[[Client], Candidate]:
    """Let a candidate compute beside what runs, on the same samples; nothing of it is written to the outputs.

    The candidate is what runs, with these values instead; only values that `set` takes while tracking.
    """
    from micromanip.settings.text.keys import assignments_of

    changes = assignments_of(assignments)
    return lambda client: client.candidate_set(changes)


@subcommand("show", "micromanip candidate show")
@client_command(_show)
def show() -> Callable[[Client], Candidate]:
    """Show where the candidate stands and how it compares with what runs; the smaller figure is the better one."""
    return Client.candidate_show


@subcommand("promote", "micromanip candidate promote --wait")
@click.option("--wait", is_flag=True, help="Wait for the end of the trial; exit code 1 where it is not confirmed.")
@socket_option
def promote(wait: bool, socket_path: Path) -> Answer:
    """Put the candidate in force at one cycle boundary, without a bump.

    It is on trial for `shadow.trial_s`: where the error grows beyond its limit, an inner loop begins to swing, or the
    tracking ends, what ran before is in force again by itself.
    """
    with Client(socket_path) as client:
        answer = client.candidate_promote()
        if wait:
            echo(_standing_line(answer), err=True)
            answer = client.candidate_outcome()
    failed = CheckFailed(f"the promoted tuning is not in force any more: {answer['standing']}")
    return Answer(answer, lambda: _show(answer), failed if wait and answer["standing"] != "confirmed" else None)


@subcommand("discard", "micromanip candidate discard")
@client_command(_show)
def discard() -> Callable[[Client], Candidate]:
    """Let the candidate go; where it is on trial, what ran before is in force again in the same cycle."""
    return Client.candidate_discard
