"""How a record is laid out: named fields in physical units, of one fixed, padded size for every configuration.

So nothing recompiles: a model with six plays uses the first six places. Lengths are in um, voltages in V, times in s
or, with the suffix, ns. Parameters never hold state, states never hold parameters: ``step(parameters, state, input)``.
"""

from __future__ import annotations

from typing import Any, TypeAlias

import numpy as np

Record: TypeAlias = Any
"""One numpy structured scalar; compiled code sees its fields by name."""

Field: TypeAlias = tuple[Any, ...]
"""Name and type of a field, with its shape where it is an array."""

MAX_AXES = 3


def record(*fields: Field) -> np.dtype[Any]:
    """Type of a record with these fields, aligned as C aligns them."""
    return np.dtype(list(fields), align=True)


def arrays(kind: str, length: int, *names: str) -> tuple[Field, ...]:
    """Fields that are arrays of so many numbers each; 0 for a number alone."""
    return tuple((name, kind, (length,)) if length else (name, kind) for name in names)


def move(source: Any, target: Any) -> Any:
    """Copy one record (an element of an array) into another one of the same kind; returns `target`, to go on with."""
    for name in source.dtype.names:
        target[name] = source[name]
    return target


def fields(record: Any) -> dict[str, Any]:
    """Views of a record's arrays, on which Python runs laws: an element costs 57 ns (of an attribute 41, of it 600)."""
    return {name: memoryview(record[name]) for name in record.dtype.names}
