"""``micromanip get``, ``set``, ``diff``, ``save``, ``reload``: parameters of the running controller, and its file."""

from __future__ import annotations

import contextlib
import json
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import click

from micromanip.client import Client
from micromanip.errors import UsageError
from micromanip.replies import Change, Differences, Parameter, Saved, Swap

from .echo import echo
from .options import Answer, Quantity, client_command, socket_option, subcommand, wants_json, warn

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
        echo(f"  {change['key']}: {brief(change['old'])} -> {brief(change['new'])}")


def _echo_swap(swap: Swap) -> None:
    """What was taken over; warnings go to standard error."""
    echo(f"parameter version {swap['version']}" if swap["changed"] else "nothing to change")
    echo_changes(swap["changed"])
    warn(swap["warnings"])


def _echo_values(parameters: list[Parameter]) -> None:
    width = max(len(parameter["change"]) for parameter in parameters)
    for parameter in parameters:
        told = f"   # {parameter['computed']}" if "computed" in parameter else ""
        echo(f"{parameter['change']:{width}}  {parameter['key']}={_shown(parameter['value'])}{told}")


def _echo_differences(found: Differences) -> None:
    echo(f"{found['file']}{': edited since it was loaded' if found['changed_on_disk'] else ''}")
    for difference in found["differences"]:
        echo(f"  {difference['key']}: file {brief(difference['file'])}, running {brief(difference['running'])}")
    if not found["differences"]:
        echo("  says what runs")


def _echo_saved(saved: Saved) -> None:
    echo(f"{saved['file']}: {'written' if saved['changed'] else 'says what runs already'}")
    echo_changes(saved["changed"])


@subcommand("get", "micromanip get axes.x.inner start.lift_s")
@click.argument("names", nargs=-1, metavar="[NAME...]")
@click.option("--watch", is_flag=True, help="Values of the loop as a live stream, a line a sample, until Ctrl-C.")
@click.option(
    "--every", "every_s", type=Quantity("Seconds", least=0.001), default=0.1, metavar="S",
    help="With --watch: the time from one sample to the next.",
)  # fmt: skip
@socket_option
def get(names: tuple[str, ...], watch: bool, every_s: float, socket_path: Path) -> Answer | None:
    """Running values of parameters, of all below NAME where it is a section; all without a NAME.

    Beside each: what changing it takes. With --watch a NAME is a value of the loop as the scope has it, x.strain_um or
    lateness_ns; without the axis it is that of each axis. With --json each sample is a document on a line of its own.
    """
    if watch and not names:
        raise UsageError("--watch needs the names of values, as in `micromanip get --watch x.strain_um`")
    with Client(socket_path) as client:
        if not watch:
            found = client.get(*names)
            return Answer(found, lambda: _echo_values(found))
        from .live_values import print_live_values

        with contextlib.suppress(KeyboardInterrupt):
            print_live_values(client, names, every_s, wants_json())
    return None


@subcommand("set", "micromanip set axes.x.inner.K_V_per_um=0.5 axes.x.inner.Ti_ms=0.6")
@click.argument("assignments", nargs=-1, required=True, metavar="KEY=VALUE...")
@client_command(_echo_swap)
def set_(assignments: tuple[str, ...]) -> Callable[[Client], Swap]:
    """Change running values, all at one cycle boundary, or none of them where one is wrong.

    VALUE is written as in the file; a list or a section too: 'axes.x.hysteresis={model: none}'. The file stays as it
    is until `micromanip save`.
    """
    from micromanip.settings.text.keys import assignments_of

    changes = assignments_of(assignments)
    return lambda client: client.set(changes)


@subcommand("diff", "micromanip diff")
@client_command(_echo_differences)
def diff() -> Callable[[Client], Differences]:
    """Values of the configuration file, as it is on disk now, that are not the running ones."""
    return Client.diff


@subcommand("save", "micromanip save")
@click.option("--force", is_flag=True, help="Also where the file was edited since it was loaded.")
@client_command(_echo_saved)
def save(force: bool) -> Callable[[Client], Saved]:
    """Write the running values into the configuration file; only changed keys change, comments stay."""
    return lambda client: client.save(force=force)


@subcommand("reload", "micromanip reload")
@client_command(_echo_swap)
def reload() -> Callable[[Client], Swap]:
    """Take over the configuration file as it is now, all of it or nothing; as SIGHUP does.

    Refused where it is not valid, or where a change needs disarm or a restart.
    """
    return Client.reload
