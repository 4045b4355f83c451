"""Lines for people: between words they go on in the next line of a terminal, and a word is never cut."""

from __future__ import annotations

import shutil
import sys
import textwrap

import click

_LEAST = 20


def echo(text: str, *, err: bool = False) -> None:
    """Print `text`, at the width of the terminal; a file or a pipe gets each line whole, for `grep`."""
    stream = sys.stderr if err else sys.stdout
    narrow = stream is not None and stream.isatty()
    click.echo(wrapped(text, shutil.get_terminal_size().columns) if narrow else text, err=err)


def wrapped(text: str, width: int) -> str:
    """`text` in lines of at most `width` columns; a word that is longer, as a path, has a line of its own."""
    width = max(width, _LEAST)
    return "\n".join(
        line
        if len(line) <= width
        else textwrap.fill(
            line,
            width,
            subsequent_indent=" " * (len(line) - len(line.lstrip()) + 2),
            break_long_words=False,
            break_on_hyphens=False,
            replace_whitespace=False,
        )
        for line in text.split("\n")
    )
