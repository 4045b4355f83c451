"""Which axes a command is about, ``--axis``; and the axes that a shell completes.

Those are of the file among the words before, else of the running controller. A shell waits for it, so it is quick (no
compiler, no schema), it ends after `_PATIENCE_S` whatever hangs, and where the axes can't be told it completes to
nothing, without a word.
"""

from __future__ import annotations

import contextlib
import re
import signal
from collections.abc import Collection, Iterator
from pathlib import Path
from typing import Any

import click

from micromanip.client import Client
from micromanip.errors import DeviceUnavailable, MicromanipError, UsageError

_PATIENCE_S = 1.0
_FILES = ("config", "into", "file")
"""Parameters that name a configuration; `file` may be a recording, which tells nothing here."""
_NAME = re.compile(r"\w[\w-]*")
"""What a shell may be given: some of it would be taken for a pattern, and commas and ends of lines for its own."""


def complete_axis(ctx: click.Context, _: click.Parameter, incomplete: str) -> list[str]:
    """For ``shell_complete``: the axes that begin so."""
    return [name for name in _axes(ctx) if name.startswith(incomplete)]


def complete_axis_or_all(ctx: click.Context, _: click.Parameter, incomplete: str) -> list[str]:
    """As `complete_axis`, for what takes `all` as well; without axes that alone helps nobody."""
    names = _axes(ctx)
    return [name for name in [*names, "all"] if names and name.startswith(incomplete)]


def _axes(ctx: click.Context) -> list[str]:
    found: list[str] = []
    with contextlib.suppress(MicromanipError, OSError, ValueError, KeyError, TypeError), _patience():
        named = list(_named(ctx))
        if named:
            found = next(filter(None, map(_of_path, named)), [])
        elif "socket_path" in ctx.params:
            with Client(ctx.params["socket_path"]) as client:
                found = list(client.status()["axes"])
    return [name for name in found if _NAME.fullmatch(name)]


def _named(ctx: click.Context) -> Iterator[Path]:
    """Files that the words before name; those of arguments are still unsorted where the last word is an option."""
    for name in _FILES:
        if isinstance(path := ctx.params.get(name), Path):
            yield path.expanduser()
    if any(isinstance(param, click.Argument) and param.name in _FILES for param in ctx.command.params):
        yield from (Path(word).expanduser() for word in ctx.args if not word.startswith("-"))


def _of_path(path: Path) -> list[str]:
    """The axes of a configuration; none where it can't be read."""
    from micromanip.settings.text.source import Source

    try:
        data = Source.read(path).data
    except MicromanipError:
        return []
    axes = data.get("axes") if isinstance(data, dict) else None
    return [name for name in axes if isinstance(name, str)] if isinstance(axes, dict) else []


@contextlib.contextmanager
def _patience() -> Iterator[None]:
    """DeviceUnavailable once it has taken too long: a controller or a disk that hangs."""

    def late(*_: Any) -> None:
        raise DeviceUnavailable("too late for a shell")

    before = signal.signal(signal.SIGALRM, late)
    signal.setitimer(signal.ITIMER_REAL, _PATIENCE_S)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, before)


axis_option = click.option(
    "--axis", "only", default="all", shell_complete=complete_axis_or_all, help="One axis, or all."
)
one_axis_option = click.option("--axis", required=True, shell_complete=complete_axis, help="The axis.")
moved_axis_option = click.option(
    "--axis", "only", required=True, shell_complete=complete_axis_or_all, help="One axis, or all, one after the other."
)


def require_axis_of(axes: Collection[str], axis: str, file: Path) -> None:
    """Raise UsageError where `axis` is none of the `axes` in `file`."""
    if axis not in axes:
        raise UsageError(f"there is no axis {axis} in {file}; its axes are {', '.join(axes)}")


def chosen_axes(axes: Collection[str], only: str, file: Path) -> list[str]:
    """What `axis_option` means of the `axes` in `file`; UsageError where there is no such one."""
    if only != "all":
        require_axis_of(axes, only, file)
    return list(axes) if only == "all" else [only]
