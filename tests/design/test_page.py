"""A page of HTML: words in its drawings are those of the page, and where it goes is tried before it is made."""

import pytest

from micromanip.cli.results import require_new_page
from micromanip.errors import MicromanipError, UsageError


def test_where_a_page_goes_is_tried_first(tmp_path):
    (tmp_path / "old.html").write_text("old")
    with pytest.raises(UsageError, match=r"old\.html is there already: .* with --to$"):
        require_new_page(tmp_path / "old.html")
    with pytest.raises(MicromanipError, match="none"):
        require_new_page(tmp_path / "none" / "new.html")
    require_new_page(tmp_path / "new.html")
    assert [file.name for file in tmp_path.iterdir()] == ["old.html"]
