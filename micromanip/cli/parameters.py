"""Values and changes of them, as several commands print them."""

from __future__ import annotations

import json
from collections.abc import Iterable
from typing import Any

import click

from micromanip.replies import Change, Swap

_BRIEF = 60


def shown(value: Any) -> str:
    """A value on one line, as `set` takes it."""
    return value if isinstance(value, str) else json.dumps(value)


def brief(value: Any) -> str:
    """The same, but of a long list only its beginning and its length."""
    text = shown(value)
    if len(text) <= _BRIEF or not isinstance(value, list):
        return text
    return f"{text[: text.rindex(',', 0, _BRIEF)]}, ...] ({len(value)} entries)"


def echo_changes(changes: Iterable[Change]) -> None:
    """A line a change."""
    for change in changes:
        click.echo(f"  {change['key']}: {brief(change['old'])} -> {brief(change['new'])}")


def echo_swap(swap: Swap) -> None:
    """What was taken over; warnings go to standard error."""
    click.echo(f"parameter version {swap['version']}" if swap["changed"] else "nothing to change")
    echo_changes(swap["changed"])
    for warning in swap["warnings"]:
        click.echo(f"WARNING: {warning}", err=True)
