"""Keys that were called otherwise in an older version of the file's layout; such a file is read all the same.

Its text is brought to the names of today before it is parsed: whatever is written into the file later has them, too.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from .place import Path
from .yaml_nodes import Document

VERSION = 2
"""Of the layout that is written."""
VERSION_KEY = "schema_version"


@dataclass(frozen=True)
class Rename:
    """What `old` (``*`` is any name) has been called since a version."""

    since: int
    old: Path
    name: str

    @property
    def new(self) -> Path:
        """Its path since."""
        return (*self.old[:-1], self.name)


RENAMES = (Rename(2, ("axes", "*", "outer", "effort"), "control_weight"),)


def new_name(path: Path, version: int = 1) -> str | None:
    """What the last part of `path`, as it is in layout `version`, is called today; None where that is its name."""
    return next((each.name for each in RENAMES if each.since > version and _fits(each.old, path)), None)


def brought_up(text: str, document: Document) -> tuple[str, dict[Path, str]]:
    """`text`, which `document` was parsed from, in today's layout, and the keys that have another name there."""
    version = document.data.get(VERSION_KEY) if isinstance(document.data, dict) else None
    if type(version) is not int or not 1 <= version < VERSION:
        return text, {}
    renamed = {path: name for path in document.keys if (name := new_name(path, version))}
    spans = {document.keys[path]: name for path, name in renamed.items()} | {
        document.values[VERSION_KEY,]: str(VERSION)
    }
    for (begin, end), words in sorted(spans.items(), reverse=True):
        text = text[:begin] + words + text[end:]
    return text, renamed


def first_names(section: Any, path: Path) -> Any:
    """`section`, which stands at `path`, with the names that its keys were given first."""
    if not isinstance(section, Mapping):
        return section
    first = {each.name: str(each.old[-1]) for each in RENAMES if _fits(each.new[:-1], path)}
    return {first.get(key, key): first_names(value, (*path, key)) for key, value in section.items()}


def _fits(pattern: Path, path: Path) -> bool:
    return len(pattern) == len(path) and all(part in ("*", name) for part, name in zip(pattern, path, strict=True))
