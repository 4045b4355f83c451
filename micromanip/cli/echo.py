"""Lines for people: between words they go on in the next line of a terminal, and a word is never cut."""

from __future__ import annotations

import re
import shutil
import sys
import textwrap
from collections.abc import Iterable

import click

_LEAST = 20
_HANGING = 2


class _NarrowFormatter(click.HelpFormatter):
    def write_usage(self, prog: str, args: str = "", prefix: str | None = None) -> None:
        """Program and arguments, from the first line on."""
        self.write(_filled(f"{prefix or 'Usage: '}{prog} {args}", self.width, "", 2 * _HANGING) + "\n")

    def write_dl(self, rows: Iterable[tuple[str, str]], col_max: int = 30, col_spacing: int = 2) -> None:
        """As click does, which cuts words that its second column has no room for: there it stands below the first."""
        rows = list(rows)
        first = min(max(len(name) for name, _ in rows), col_max) + col_spacing
        longest = max((len(word) for _, text in rows for word in text.split()), default=0)
        if self.current_indent + first + longest <= self.width:
            super().write_dl(rows, col_max, col_spacing)
            return
        for name, text in rows:
            self.write(f"{'':{self.current_indent}}{name.rstrip()}\n")
            self.write(_filled(text, self.width, " " * (self.current_indent + 4)) + "\n")

    def getvalue(self) -> str:
        """What was written; examples, whose lines click leaves as they are, go on in the next line, too."""
        return wrapped(super().getvalue(), self.width)


class NarrowContext(click.Context):
    """Help for terminals below the 50 columns that click takes for granted."""

    formatter_class = _NarrowFormatter

    def make_formatter(self) -> click.HelpFormatter:
        """As click does, at the width that there is."""
        width = max(min(shutil.get_terminal_size().columns, 80) - 2, _LEAST)
        return self.formatter_class(width=width)


def echo(text: str, *, err: bool = False) -> None:
    """Print `text`, at the width of the terminal; a file or a pipe gets each line whole, for `grep`."""
    stream = sys.stderr if err else sys.stdout
    narrow = stream is not None and stream.isatty()
    click.echo(wrapped(text, shutil.get_terminal_size().columns) if narrow else text, err=err)


def wrapped(text: str, width: int) -> str:
    """`text` in lines of at most `width` columns; a word that is longer, as a path, has a line of its own.

    A line goes on below the last of its columns that begins in its first half: columns are two spaces apart.
    """
    width = max(width, _LEAST)
    return "\n".join(
        line if len(line) <= width else _filled(line.strip(), width, line[: -len(line.lstrip())], _hanging(line, width))
        for line in text.split("\n")
    )


def _filled(text: str, width: int, margin: str, hanging: int | None = None) -> str:
    further = margin if hanging is None else " " * hanging
    return textwrap.fill(
        text,
        width,
        initial_indent=margin,
        subsequent_indent=further,
        break_long_words=False,
        break_on_hyphens=False,
        replace_whitespace=False,
    )


def _hanging(line: str, width: int) -> int:
    columns = [found.end() for found in re.finditer(r"(?<=\S) {2,}(?=\S)", line) if found.end() <= width // 2]
    margin = len(line) - len(line.lstrip())
    return max([margin + _HANGING, *columns])
