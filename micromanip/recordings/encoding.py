"""Bytes of a text file as text: UTF-8, UTF-16 with or without its mark, and the old code page of Western Europe.

UTF-16 that can't be decoded is a file that is cut off or damaged, and its numbers would be wrong ones: it is refused. A
text of single bytes keeps its numbers whatever its letters are, so of that an odd letter is replaced.
"""

from __future__ import annotations

from pathlib import Path

from micromanip.errors import CheckFailed
from micromanip.files.byte_order_mark import marked_encoding

_LOOKED_AT = 4096
_TEXT = {9, 10, 11, 12, 13, 27, *range(32, 256)}


def decoded(file: Path, content: bytes) -> str:
    """The text. CheckFailed where it is none, or ends within a character."""
    if marked := marked_encoding(content):
        return _strictly(file, content, marked)
    head = content[:_LOOKED_AT]
    zeros = [head[side::2].count(0) / max(len(head[side::2]), 1) for side in (0, 1)]
    if max(zeros) > 0.4 and min(zeros) < 0.1:
        return _strictly(file, content, "utf-16-be" if zeros[0] > zeros[1] else "utf-16-le")
    if any(byte not in _TEXT for byte in head):
        raise CheckFailed(
            f"{file}: neither text nor a format that is known here; save it as CSV, .mat, .npz, HDF5 or Parquet"
        )
    try:
        return content.decode("utf-8")
    except UnicodeDecodeError:
        return content.decode("cp1252", errors="replace")  # a degree or micro sign of an older Windows


def _strictly(file: Path, content: bytes, encoding: str) -> str:
    try:
        return content.decode(encoding)
    except UnicodeDecodeError as problem:
        raise CheckFailed(f"{file}: byte {problem.start} is no {encoding}: the file is cut off or damaged") from problem
