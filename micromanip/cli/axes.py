"""Which axes a command is about: ``--axis``."""

from __future__ import annotations

from collections.abc import Collection
from pathlib import Path

import click

from micromanip.errors import UsageError

axis_option = click.option("--axis", "only", default="all", help="One axis, or all.")
one_axis_option = click.option("--axis", required=True, help="The axis.")
moved_axis_option = click.option("--axis", "only", required=True, help="One axis, or all, one after the other.")


def require_axis_of(axes: Collection[str], axis: str, file: Path) -> None:
    """Raise UsageError where `axis` is none of the `axes` in `file`."""
    if axis not in axes:
        raise UsageError(f"there is no axis {axis} in {file}; its axes are {', '.join(axes)}")


def chosen_axes(axes: Collection[str], only: str, file: Path) -> list[str]:
    """What `axis_option` means of the `axes` in `file`; UsageError where there is no such one."""
    if only != "all":
        require_axis_of(axes, only, file)
    return list(axes) if only == "all" else [only]
