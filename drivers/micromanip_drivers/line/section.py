"""Types of keys that the sections of several drivers have."""

from __future__ import annotations

from typing import Annotated

from pydantic import AfterValidator, Field


def _hexadecimal(text: str) -> str:
    try:
        bytes.fromhex(text)
    except ValueError:
        raise ValueError(f'"{text}" is not hexadecimal: two digits a byte, for example "aa 55"') from None
    return text


HexBytes = Annotated[str, AfterValidator(_hexadecimal)]
"""Bytes as hexadecimal text, blanks between them or not."""
Name = Annotated[str, Field(pattern=r"^[A-Za-z_][A-Za-z0-9_]*$")]
Place = Annotated[int, Field(strict=True, ge=0, le=65_535)]
Count = Annotated[int, Field(strict=True, ge=1, le=65_535)]
Whole = Annotated[int, Field(strict=True, ge=-(2**63), le=2**64 - 1)]
