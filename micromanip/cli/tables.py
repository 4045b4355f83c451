"""Tables of figures that are never cut: text wraps between words, and where even that is too wide rows are stacked."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace

from rich.console import Console, ConsoleOptions, RenderableType, RenderResult
from rich.measure import Measurement
from rich.padding import Padding
from rich.table import Table
from rich.text import Text

_WIDE = 160
_BORDERS = 3
"""Columns of the terminal that each column of a table takes beside its text; one more closes it."""


def out_console() -> Console:
    """Standard output; where it is no terminal nothing need fit, unless COLUMNS says so."""
    fits = sys.stdout.isatty() or "COLUMNS" in os.environ
    return Console(highlight=False, width=None if fits else _WIDE)


def print_table(
    columns: Sequence[str],
    rows: Iterable[Sequence[RenderableType]],
    title: str | None = None,
    caption: str | None = None,
    *,
    numbers: bool = False,
) -> None:
    """A table on standard output, nothing without rows; `numbers` are on the right, but for the first column."""
    table = Figures(*columns, title=title, caption=caption)
    for row in rows:
        table.add_row(*row)
    for column in table.columns[1:] if numbers else ():
        column.justify = "right"
    if table.row_count:
        out_console().print(table)


class Figures(Table):
    """A table of rich that gives its columns the room that they need, or stacks its rows."""

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        widths = self._widths(console, options)
        if widths is None:
            yield from self._stacked()
            return
        shown, self.columns = self.columns, [replace(c, width=w) for c, w in zip(self.columns, widths, strict=True)]
        try:
            yield from super().__rich_console__(console, options)
        finally:
            self.columns = shown

    def __rich_measure__(self, console: Console, options: ConsoleOptions) -> Measurement:
        return Measurement(1, options.max_width)

    def _widths(self, console: Console, options: ConsoleOptions) -> list[int] | None:
        """Of each column; None where the longest words do not fit side by side."""
        least, most = [], []
        for column in self.columns:
            cells = [Measurement.get(console, options, cell) for cell in (column.header, *column.cells)]
            least.append(max(cell.minimum for cell in cells))
            most.append(max(cell.maximum for cell in cells))
        left = options.max_width - _BORDERS * len(least) - 1 - sum(least)
        if left < 0:
            return None
        for i, wanted in sorted(enumerate(most), key=lambda each: each[1] - least[each[0]]):
            more = min(wanted - least[i], left)
            least[i] += more
            left -= more
        return least

    def _stacked(self) -> Iterator[RenderableType]:
        if self.title:
            yield Text(str(self.title), style="italic")
        headers = [_text(column.header) for column in self.columns]
        for name, *cells in zip(*(column.cells for column in self.columns), strict=True):
            yield Text.assemble(headers[0], " " if headers[0] else "", _text(name), style="bold")
            for header, cell in zip(headers[1:], map(_text, cells), strict=True):
                if cell:
                    yield Padding(Text.assemble(header, " " if header else "", cell), (0, 0, 0, 2))
        if self.caption:
            yield Text(str(self.caption), style="dim")


def _text(cell: object) -> Text:
    return cell if isinstance(cell, Text) else Text.from_markup(str(cell))
