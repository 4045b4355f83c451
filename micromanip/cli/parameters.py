"""``micromanip get``, ``set``, ``diff``, ``save``, ``reload``: parameters of the running controller, and its file."""

from __future__ import annotations

import json
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import click

from micromanip.client import Client
from micromanip.replies import Change, Swap

from .options import StrictCommand, json_option, print_json, socket_option

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
        click.echo(f"  {change['key']}: {brief(change['old'])} -> {brief(change['new'])}")


def _echo_swap(swap: Swap) -> None:
    """What was taken over; warnings go to standard error."""
    click.echo(f"parameter version {swap['version']}" if swap["changed"] else "nothing to change")
    echo_changes(swap["changed"])
    for warning in swap["warnings"]:
        click.echo(f"WARNING: {warning}", err=True)


@click.command("get", cls=StrictCommand, epilog="Example: micromanip get axes.x.inner start.lift_s")
@click.argument("keys", nargs=-1, metavar="[KEY...]")
@socket_option
@json_option
def get(keys: tuple[str, ...], socket_path: Path, as_json: bool) -> None:
    """Running values of KEYs, of all below where one is a section; all values without a KEY.

    Beside each: what changing it takes.
    """
    with Client(socket_path) as client:
        parameters = client.get(*keys)
    if as_json:
        print_json(parameters)
        return
    width = max(len(parameter["change"]) for parameter in parameters)
    for parameter in parameters:
        click.echo(f"{parameter['change']:{width}}  {parameter['key']}={_shown(parameter['value'])}")


@click.command(
    "set", cls=StrictCommand, epilog="Example: micromanip set axes.x.inner.K_V_per_um=0.5 axes.x.inner.Ti_ms=0.6"
)
@click.argument("assignments", nargs=-1, required=True, metavar="KEY=VALUE...")
@socket_option
@json_option
def set_(assignments: tuple[str, ...], socket_path: Path, as_json: bool) -> None:
    """Change running values, all at one cycle boundary, or none of them where one is wrong.

    VALUE is written as in the file; a list or a section too: 'axes.x.hysteresis={model: none}'. The file stays as it
    is until `micromanip save`.
    """
    from micromanip.settings.text.keys import assignments_of

    changes = assignments_of(assignments)
    with Client(socket_path) as client:
        swap = client.set(changes)
    if as_json:
        print_json(swap)
    else:
        _echo_swap(swap)


@click.command("diff", cls=StrictCommand, epilog="Example: micromanip diff")
@socket_option
@json_option
def diff(socket_path: Path, as_json: bool) -> None:
    """Values of the configuration file, as it is on disk now, that are not the running ones."""
    with Client(socket_path) as client:
        found = client.diff()
    if as_json:
        print_json(found)
        return
    click.echo(f"{found['file']}{': edited since it was loaded' if found['changed_on_disk'] else ''}")
    for difference in found["differences"]:
        click.echo(f"  {difference['key']}: file {brief(difference['file'])}, running {brief(difference['running'])}")
    if not found["differences"]:
        click.echo("  says what runs")


@click.command("save", cls=StrictCommand, epilog="Example: micromanip save")
@click.option("--force", is_flag=True, help="Also where the file was edited since it was loaded.")
@socket_option
@json_option
def save(force: bool, socket_path: Path, as_json: bool) -> None:
    """Write the running values into the configuration file; only changed keys change, comments stay."""
    with Client(socket_path) as client:
        saved = client.save(force=force)
    if as_json:
        print_json(saved)
        return
    click.echo(f"{saved['file']}: {'written' if saved['changed'] else 'says what runs already'}")
    echo_changes(saved["changed"])


@click.command("reload", cls=StrictCommand, epilog="Example: micromanip reload")
@socket_option
@json_option
def reload(socket_path: Path, as_json: bool) -> None:
    """Take over the configuration file as it is now, all of it or nothing; as SIGHUP does.

    Refused where it is not valid, or where a change needs disarm or a restart.
    """
    with Client(socket_path) as client:
        swap = client.reload()
    if as_json:
        print_json(swap)
    else:
        _echo_swap(swap)
