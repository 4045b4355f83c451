"""Lines for people at the width of a terminal: no word is cut, nothing is left out."""

from hypothesis import given
from hypothesis import strategies as st

from micromanip.cli.echo import wrapped

WORD = st.text("abcxyz0123456789./:-", min_size=1, max_size=30)
LINES = st.lists(st.tuples(st.integers(0, 8), st.lists(WORD, max_size=12)), max_size=4)


@given(LINES, st.integers(24, 100), st.sampled_from([" ", "  "]))
def test_every_word_is_whole_and_no_line_is_too_long_but_for_a_word(lines, width, gap):
    text = "\n".join(" " * margin + gap.join(words) for margin, words in lines)
    shown = wrapped(text, width)
    assert shown.split() == text.split()
    assert all(len(line) <= width or len(line.split()) == 1 for line in shown.splitlines())
    assert wrapped(text, 1000) == text
