"""Lines for people at the width of a terminal: no word is cut, nothing is left out."""

import sys

import pytest
from hypothesis import given
from hypothesis import strategies as st

from micromanip.cli.echo import wrapped

from .command import code_of

WORD = st.text("abcxyz0123456789./:-", min_size=1, max_size=30)
LINES = st.lists(st.tuples(st.integers(0, 8), st.lists(WORD, max_size=12)), max_size=4)


@given(LINES, st.integers(24, 100), st.sampled_from([" ", "  "]))
def test_every_word_is_whole_and_no_line_is_too_long_but_for_a_word(lines, width, gap):
    text = "\n".join(" " * margin + gap.join(words) for margin, words in lines)
    shown = wrapped(text, width)
    assert shown.split() == text.split()
    assert all(len(line) <= width or len(line.split()) == 1 for line in shown.splitlines())
    assert wrapped(text, 1000) == text


@pytest.mark.parametrize("width", [40, 60])
def test_help_fits_a_narrow_terminal(width, monkeypatch, capsys):
    monkeypatch.setenv("COLUMNS", str(width))
    for name in ([], *([name] for name in ("status", "run", "gateway", "recording", "fit"))):
        assert code_of(*name, "--help") == 0
        shown = capsys.readouterr().out
        assert [line for line in shown.splitlines() if len(line) > width and len(line.split()) > 1] == []
        assert "/run/micromanip/control.sock" in shown or "status" not in name


def test_an_error_is_wrapped_on_a_terminal_and_whole_in_a_log(tmp_path, monkeypatch, capsys):
    """COLUMNS may be exported by whatever started us; what reads a log or a pipe looks for whole lines all the same."""
    (tmp_path / "a configuration that is a folder").mkdir()
    monkeypatch.chdir(tmp_path)
    said = "micromanip: a configuration that is a folder: a directory; name the YAML file in it"
    monkeypatch.setenv("COLUMNS", "40")
    assert code_of("check", "a configuration that is a folder") == 78
    assert capsys.readouterr().err.splitlines() == [said]
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True)
    assert code_of("check", "a configuration that is a folder") == 78
    lines = capsys.readouterr().err.splitlines()
    assert max(map(len, lines)) <= 40
    assert " ".join(" ".join(lines).split()) == said
