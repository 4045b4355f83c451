"""A line of a table as text, so that programs take its columns for numbers."""

from __future__ import annotations

from collections.abc import Iterable


def table_line(fields: Iterable[str]) -> str:
    """Numbers between commas; what is not known is ``NaN``, since polars takes a column with a ``nan`` for text."""
    return ",".join(fields).replace("nan", "NaN")
