"""A page of HTML: words in its drawings are those of the page, and where it goes is tried before it is made."""

import pytest

from micromanip.cli.results import require_new_page
from micromanip.design.page import INK, drawing, section
from micromanip.errors import MicromanipError, UsageError


def test_words_of_a_drawing_have_the_colour_of_the_page():
    """Light or dark: each label, tick and legend."""
    figure, panels = drawing()
    panels[0, 0].plot([0, 1], label="x")
    panels[0, 0].set(xlabel="time, s", ylabel="error, um")
    panels[0, 0].legend(labelcolor=INK)
    drawn = section("Error", "While tracking.", figure)
    words = [line for line in drawn.splitlines() if "<text" in line]
    assert len(words) > 6
    assert all("fill: currentColor" in line for line in words)
    assert INK not in drawn


def test_where_a_page_goes_is_tried_first(tmp_path):
    (tmp_path / "old.html").write_text("old")
    with pytest.raises(UsageError, match=r"old\.html is there already: .* with --to$"):
        require_new_page(tmp_path / "old.html")
    with pytest.raises(MicromanipError, match="none"):
        require_new_page(tmp_path / "none" / "new.html")
    require_new_page(tmp_path / "new.html")
    assert [file.name for file in tmp_path.iterdir()] == ["old.html"]
