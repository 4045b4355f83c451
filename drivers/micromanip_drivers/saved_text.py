"""Text as other programs save it: descriptions of devices come from anywhere.

A letter in a name or a comment that can't be decoded is replaced, and no reason to keep a device from running; in a
recording it would be a wrong number, so those are decoded strictly (``micromanip/recordings/encoding.py``).
"""

from __future__ import annotations

from micromanip.driver import marked_encoding


def decoded(data: bytes, otherwise: str) -> str:
    """In the encoding that its byte-order mark names, else UTF-8, else `otherwise`; without the end mark of DOS."""
    try:
        text = data.decode(marked_encoding(data) or "utf-8")
    except UnicodeDecodeError:
        text = data.decode(otherwise, errors="replace")
    return text.rstrip("\x1a\0")
