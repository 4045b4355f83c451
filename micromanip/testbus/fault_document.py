"""A fault that is to be injected, from the mapping that a command holds."""

from __future__ import annotations

from typing import TypeVar

from pydantic import TypeAdapter, ValidationError

from micromanip.errors import UsageError

_Fault = TypeVar("_Fault")


def validated(kinds: TypeAdapter[_Fault], document: object) -> _Fault:
    """The fault among `kinds` that `document` describes. Raises UsageError with the first thing that is wrong."""
    try:
        return kinds.validate_python(document)
    except ValidationError as error:
        first = error.errors()[0]
        where = " ".join(str(part) for part in first["loc"])
        raise UsageError(f"fault{f' {where}' if where else ''}: {first['msg']}") from error
