"""The manual as a site: every link leads somewhere, nothing is fetched, and the search knows its words."""

import json
import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    folder = tmp_path_factory.mktemp("site")
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "--site-dir", str(folder)]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return folder


def test_every_page_is_there(site):
    pages = {page.relative_to(ROOT / "docs").with_suffix(".html") for page in (ROOT / "docs").rglob("*.md")}
    made = {page.relative_to(site) for page in site.rglob("*.html")}
    assert pages <= made
    assert {Path("project/index.html"), Path("project/CHANGELOG.html")} <= made  # a README is its folder's index


def test_nothing_is_fetched_from_elsewhere(site):
    fetched = re.compile(r"""<(?:script|img|link|iframe)\b[^>]*?\b(?:src|href)=["']?(https?:)?//""")
    assert [page.name for page in site.rglob("*.html") if fetched.search(page.read_text())] == []


def test_the_search_finds_a_word_of_a_page(site):
    index = json.loads((site / "search" / "search_index.json").read_text())
    assert {
        entry["location"].split("#")[0] for entry in index["docs"] if "describing function" in entry["text"].lower()
    } >= {"theory.html", "analyse.html"}
