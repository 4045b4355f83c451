"""What the pages point at exists: files, headings, functions; and every picture is shown somewhere."""

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
PAGES = [*sorted(ROOT.glob("*.md")), *sorted((ROOT / "docs").rglob("*.md"))]
LINK = re.compile(r"\[(?P<text>[^\]]*)\]\((?P<target>[^)\s]+)\)")


def links(page):
    """(text, path, anchor) of every relative link on a page, code blocks left out."""
    text = re.sub(r"```.*?```", "", page.read_text(encoding="utf-8"), flags=re.DOTALL)
    for match in LINK.finditer(text):
        target = match["target"]
        if not target.startswith(("http://", "https://")):
            path, _, anchor = target.partition("#")
            yield match["text"], (page.parent / path).resolve() if path else page, anchor


def anchors(page):
    """Names of a page's headings, as code hosts make them."""
    headings = re.findall(r"^#+ (.*)$", page.read_text(encoding="utf-8"), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_links_lead_somewhere(page):
    for text, path, anchor in links(page):
        assert path.exists(), f"{page.name}: [{text}] leads to {path}, which is not there"
        assert not anchor or anchor in anchors(path), f"{page.name}: {path.name} has no heading #{anchor}"


def test_every_page_and_picture_is_reached_from_the_index():
    reached, ahead = set(), [ROOT / "docs" / "index.md"]
    while ahead:
        page = ahead.pop()
        reached.add(page)
        led = {path for _, target, _ in links(page) for path in (target.glob("*.md") if target.is_dir() else [target])}
        ahead += [path for path in led - reached if path.suffix == ".md" and path.exists()]
        reached |= led
    wanted = {*PAGES, *(ROOT / "docs" / "pictures").glob("*.svg")}
    assert {str(path.relative_to(ROOT)) for path in wanted - reached} == set()
