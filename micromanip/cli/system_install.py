"""``micromanip system install``: shows what it will do, asks, does it; and undoes it."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import click

from micromanip.errors import MicromanipError, UsageError

from .echo import echo
from .options import emit_json, subcommand, warn


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
def command(
    config: Path | None, dry_run: bool, yes: bool, uninstall: bool, purge: bool, root: Path, as_json: bool
) -> None:
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
        steps = plan.uninstall(machine, root, purge=purge)
    else:
        steps = plan.install(machine, config, root, warnings.append)
    warn(warnings)
    described = [{"step": step.sentence, "diff": list(step.diff)} for step in steps]
    if not as_json:
        _show(described)
    if steps and not dry_run:
        if not yes:
            _ask()
        plan.carry_out(steps, root, lambda line: echo(line, err=True))
        if not as_json:
            echo("removed" if uninstall else f"installed; `systemctl restart {layout.UNIT}` puts it in force")
    if as_json:
        emit_json({"steps": described, "done": bool(steps) and not dry_run, "warnings": warnings})


def _ask() -> None:
    if not sys.stdin.isatty():
        raise UsageError("nobody is there to ask; add --yes to do it, or --dry-run to see it only")
    click.confirm("Do this?", abort=True, err=True)


def _show(steps: list[dict[str, Any]]) -> None:
    if not steps:
        echo("nothing to do: all is as it should be")
    for step in steps:
        echo(step["step"])
        for line in step["diff"]:
            click.echo(f"    {line}")  # of a file: as it is
