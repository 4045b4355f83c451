"""The encoding that a text file names by its first bytes."""

from __future__ import annotations

import codecs

_MARKS = {codecs.BOM_UTF8: "utf-8-sig", codecs.BOM_UTF16_LE: "utf-16", codecs.BOM_UTF16_BE: "utf-16"}


def marked_encoding(content: bytes) -> str | None:
    """utf-8-sig or utf-16, which decode without the mark, or None where `content` begins with no byte-order mark."""
    return next((encoding for mark, encoding in _MARKS.items() if content.startswith(mark)), None)
