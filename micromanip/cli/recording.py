"""``micromanip recording start``, ``stop``, ``mark``: recordings of the running controller."""

from __future__ import annotations

from collections.abc import Callable

import click

from micromanip.client import Client
from micromanip.errors import UsageError
from micromanip.replies import Marked
from micromanip.status_reply import Recorded

from .echo import echo
from .options import Quantity, client_command, subcommand


def _show_begun(recorded: Recorded) -> None:
    echo(f"recording to {recorded['file']}")


def _show_ended(recorded: Recorded) -> None:
    size = recorded["bytes"] / 1e6
    echo(f"recorded {recorded['rows']} cycles to {recorded['file']}, {size:.1f} MB, {recorded['dropped']} lost")


def _show_marked(marked: Marked) -> None:
    echo(f"marked cycle {marked['cycle']} in {marked['file']}")


@subcommand("start", "micromanip recording start part17.mcap --before 3")
@click.argument("file", required=False)
@click.option(
    "--before", "before_s", type=Quantity("SecondsOrZero", most=5.0), default=0.0, help="Begin so much earlier, s."
)
@click.option(
    "--segment",
    "minutes",
    type=Quantity("SecondsOrZero", least=0.1, most=1440.0),
    help="Another file each so many minutes.",
)
@click.option(
    "--quota",
    "quota_GB",
    type=Quantity("SecondsOrZero", least=0.001),
    help="Remove the oldest of them beyond so many GB.",
)
@client_command(_show_begun)
def start(
    file: str | None,
    before_s: float,
    minutes: float | None,
    quota_GB: float | None,
) -> Callable[[Client], Recorded]:
    """Begin a recording: FILE.mcap, a name without a folder; named for the time without one.

    It goes to the folder that `run --recordings` names, and replaces nothing there.
    """
    if (minutes is None) != (quota_GB is None):
        raise UsageError("--segment and --quota go together: how long a file is, and how much all may take")
    return lambda client: client.recording_start(
        file,
        before_s=before_s,
        segment_s=None if minutes is None else minutes * 60.0,
        quota_bytes=None if quota_GB is None else round(quota_GB * 1e9),
    )


@subcommand("stop", "micromanip recording stop")
@client_command(_show_ended)
def stop() -> Callable[[Client], Recorded]:
    """End the recording; all that was recorded until now is in the file."""
    return Client.recording_stop


@subcommand("mark", 'micromanip recording mark "coolant on"')
@click.argument("text")
@client_command(_show_marked)
def mark(text: str) -> Callable[[Client], Marked]:
    """Put a remark into the recording, at this cycle."""
    return lambda client: client.recording_mark(text)
