"""Bars on standard error with the time that is left, where it can be known; nothing where that is no terminal."""

from __future__ import annotations

import contextlib
import re
from collections.abc import Callable, Iterator, Sequence
from typing import TYPE_CHECKING

from .echo import echo

if TYPE_CHECKING:
    from rich.progress import Progress, TaskID


def show_compiling(show: Callable[[str], None] = lambda line: echo(line, err=True)) -> None:
    """Let `show` have what is compiled in this process from now on, and how long it will take."""
    from micromanip.rt.jit import Compiler

    Compiler.tell = staticmethod(lambda name: show(f"compiling {name} for this processor, once after an update"))
    Compiler.tell_left = staticmethod(lambda name, seconds: show(f"compiling {name}: {seconds:.0f} s left"))


_NARROW = 70
"""Below it what is done, its share and the time left stand alone, and the first goes on in the next line."""
_COUNTED = re.compile(r"\b(\d+) of (\d+)\b")
"""As in "plant 7 of 200": the work says itself how far it is."""


class Steps:
    """What is being done, one step after the other; each is told as it begins."""

    def __init__(self, bar: Progress, plan: Sequence[tuple[str, float]] = ()) -> None:
        """`plan` names the steps that are known beforehand, in order, each with the share of the time that it takes.

        One that does not come is passed over. Without a plan a step counts where it says "7 of 200".
        """
        self.console = bar.console
        self._bar, self._plan = bar, list(plan)
        self._task: TaskID = bar.add_task("", total=sum(share for _, share in plan) or None)
        self._at, self._counted = 0, 0

    def say(self, what: str) -> None:
        """The step that begins now."""
        self._bar.update(self._task, description=what)
        names = [name for name, _ in self._plan]
        if what in names[self._at :]:
            self._at = names.index(what, self._at)
            self._bar.update(self._task, completed=sum(share for _, share in self._plan[: self._at]))
        elif not self._plan:
            counted = _COUNTED.search(what)
            place, count = (int(number) for number in counted.groups()) if counted else (0, 0)
            if count != self._counted:
                self._counted = count
                self._bar.remove_task(self._task)  # a task that has a total keeps one
                self._task = self._bar.add_task(what, total=count or None)
            if count:
                self._bar.update(self._task, completed=place - 1)


@contextlib.contextmanager
def steps(plan: Sequence[tuple[str, float]] = ()) -> Iterator[Steps]:
    """A bar that is gone at the end."""
    from rich.console import Console
    from rich.progress import (
        BarColumn,
        Progress,
        ProgressColumn,
        TaskProgressColumn,
        TextColumn,
        TimeElapsedColumn,
        TimeRemainingColumn,
    )
    from rich.table import Column

    console = Console(stderr=True)
    columns: tuple[ProgressColumn, ...] = (
        TextColumn("{task.description}"), BarColumn(), TaskProgressColumn(), TimeElapsedColumn(), TextColumn("left"),
        TimeRemainingColumn(),
    )  # fmt: skip
    if console.width < _NARROW:
        columns = (TextColumn("{task.description}", table_column=Column()), *columns[2:3], *columns[4:])
    with Progress(*columns, console=console, transient=True, disable=not console.is_terminal) as bar:
        yield Steps(bar, plan)
