"""``micromanip get``, ``set``, ``diff``, ``save``, ``reload``: parameters of the running controller, and its file."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable
from typing import Any

import click

from micromanip.client import Client
from micromanip.replies import Change, Differences, Parameter, Saved, Swap

from .options import StrictCommand, asking, warn
from .prose import say

_BRIEF = 60


def _shown(value: Any) -> str:
    """A value on one line, as `set` takes it."""
    return value if isinstance(value, str) else json.dumps(value)


def brief(value: Any) -> str:
    """The same, but of a long list only its beginning and its length."""
    text = _shown(value)
    if len(text) <= _BRIEF or not isinstance(value, list):
        return text
    return f"{text[: text.rindex(',', 0, _BRIEF)]}, ...] ({len(value)} entries)"


def echo_changes(changes: Iterable[Change]) -> None:
    """A line per change."""
    for change in changes:
        say(f"  {change['key']}: {brief(change['old'])} -> {brief(change['new'])}")


def _echo_swap(swap: Swap) -> None:
    """What was taken over; warnings go to standard error."""
    say(f"parameter version {swap['version']}" if swap["changed"] else "nothing to change")
    echo_changes(swap["changed"])
    warn(swap["warnings"])


def _echo_values(parameters: list[Parameter]) -> None:
    width = max(len(parameter["change"]) for parameter in parameters)
    for parameter in parameters:
        say(f"{parameter['change']:{width}}  {parameter['key']}={_shown(parameter['value'])}")


def _echo_differences(found: Differences) -> None:
    say(f"{found['file']}{': edited since it was loaded' if found['changed_on_disk'] else ''}")
    for difference in found["differences"]:
        say(f"  {difference['key']}: file {brief(difference['file'])}, running {brief(difference['running'])}")
    if not found["differences"]:
        say("  says what runs")


def _echo_saved(saved: Saved) -> None:
    say(f"{saved['file']}: {'written' if saved['changed'] else 'says what runs already'}")
    echo_changes(saved["changed"])


@click.command("get", cls=StrictCommand, epilog="Example: micromanip get axes.x.inner start.lift_s")
@click.argument("keys", nargs=-1, metavar="[KEY...]")
@asking(_echo_values)
def get(keys: tuple[str, ...]) -> Callable[[Client], list[Parameter]]:
    """Running values of KEYs, of all below where one is a section; all values without a KEY.

    Beside each: what changing it takes.
    """
    return lambda client: client.get(*keys)


@click.command(
    "set", cls=StrictCommand, epilog="Example: micromanip set axes.x.inner.K_V_per_um=0.5 axes.x.inner.Ti_ms=0.6"
)
@click.argument("assignments", nargs=-1, required=True, metavar="KEY=VALUE...")
@asking(_echo_swap)
def set_(assignments: tuple[str, ...]) -> Callable[[Client], Swap]:
    """Change running values, all at one cycle boundary, or none of them where one is wrong.

    VALUE is written as in the file; a list or a section too: 'axes.x.hysteresis={model: none}'. The file stays as it
    is until `micromanip save`.
    """
    from micromanip.settings.text.keys import assignments_of

    changes = assignments_of(assignments)
    return lambda client: client.set(changes)


@click.command("diff", cls=StrictCommand, epilog="Example: micromanip diff")
@asking(_echo_differences)
def diff() -> Callable[[Client], Differences]:
    """Values of the configuration file, as it is on disk now, that are not the running ones."""
    return Client.diff


@click.command("save", cls=StrictCommand, epilog="Example: micromanip save")
@click.option("--force", is_flag=True, help="Also where the file was edited since it was loaded.")
@asking(_echo_saved)
def save(force: bool) -> Callable[[Client], Saved]:
    """Write the running values into the configuration file; only changed keys change, comments stay."""
    return lambda client: client.save(force=force)


@click.command("reload", cls=StrictCommand, epilog="Example: micromanip reload")
@asking(_echo_swap)
def reload() -> Callable[[Client], Swap]:
    """Take over the configuration file as it is now, all of it or nothing; as SIGHUP does.

    Refused where it is not valid, or where a change needs disarm or a restart.
    """
    return Client.reload
