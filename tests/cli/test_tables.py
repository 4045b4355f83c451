"""Tables at any width: what stands in them is never cut."""

import io
import re

from hypothesis import given
from hypothesis import strategies as st
from rich.console import Console

from micromanip.cli.tables import Figures

WORDS = st.lists(st.text("abcxyz0123456789.", min_size=1, max_size=14), min_size=1, max_size=4).map(" ".join)


def printed(renderable, width):
    out = io.StringIO()
    Console(file=out, width=width, highlight=False).print(renderable)
    return out.getvalue()


def words(text):
    return re.sub(r"[^\w.\-]+", " ", text).split()


@given(st.lists(st.lists(WORDS, min_size=3, max_size=3), min_size=1, max_size=5), st.integers(24, 160))
def test_every_word_is_shown_whole_and_no_line_is_too_long(rows, width):
    table = Figures("first", "second", "third", title="a title")
    for row in rows:
        table.add_row(*row)
    shown = printed(table, width)
    assert max(len(line) for line in shown.splitlines()) <= width
    seen = words(shown)
    for word in (word for row in rows for cell in row for word in cell.split()):
        assert word in seen, shown
