"""Hooks of MkDocs: the root's pages join the manual; links to sources, which the site does not hold, become text."""

from __future__ import annotations

import posixpath
import re
from pathlib import Path
from typing import Any

from mkdocs.structure.files import File, Files

_ROOT = Path(__file__).parent.parent
_JOINED = {name: f"project/{name}" for name in ("README.md", "CONTRIBUTING.md", "CHANGELOG.md")}
_LINK = re.compile(r"(!?)\[((?:[^\[\]]|\[[^\]]*\])*)\]\(([^)\s#:]+)(#[^)\s]*)?\)")


def on_files(files: Files, *, config: Any, **_: Any) -> Files:
    """Add README and what stands beside it."""
    for name, place in _JOINED.items():
        files.append(File.generated(config, place, abs_src_path=str(_ROOT / name)))
    return files


def on_page_markdown(markdown: str, *, page: Any, files: Files, **_: Any) -> str:
    """Lead each link to where its target is on the site."""
    place = page.file.src_uri
    own = next((name for name, joined in _JOINED.items() if joined == place), None)
    at = "docs/" + posixpath.dirname(place) if own is None else ""

    def led(link: re.Match[str]) -> str:
        picture, text, target, anchor = link[1], link[2], link[3], link[4] or ""
        found = posixpath.normpath(posixpath.join(at, target))
        found = _JOINED.get(found, found.removeprefix("docs/") if found.startswith("docs/") else "")
        if files.get_file_from_path(found) is None:
            return text
        return f"{picture}[{text}]({posixpath.relpath(found, posixpath.dirname(place) or '.')}{anchor})"

    return _LINK.sub(led, markdown)
