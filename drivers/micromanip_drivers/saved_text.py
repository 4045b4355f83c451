"""Text as other programs save it: descriptions of devices come from anywhere."""

from __future__ import annotations

import codecs

_MARKS = ((codecs.BOM_UTF8, "utf-8-sig"), (codecs.BOM_UTF16_LE, "utf-16"), (codecs.BOM_UTF16_BE, "utf-16"))


def decoded(data: bytes, otherwise: str) -> str:
    """In the encoding that its byte-order mark names, else UTF-8, else `otherwise`; without the end mark of DOS."""
    encoding = next((name for mark, name in _MARKS if data.startswith(mark)), "utf-8")
    try:
        text = data.decode(encoding)
    except UnicodeDecodeError:
        text = data.decode(otherwise, errors="replace")
    return text.rstrip("\x1a\0")
