"""Writes ``records.h``: the controller's records and constants as C sees them, on the same bytes.

Generated from the numpy dtypes, so that a changed record can never be read with a stale layout; sizes
and offsets are asserted by the C compiler once more.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from micromanip.rt import (
    arming,
    axis_order,
    faults,
    figures,
    limit_cycle,
    oscillation,
    record,
    records,
    reference_blend,
    states,
    supervisor,
    telemetry,
    watch,
)
from micromanip.rt.laws import (
    coordinate_transform,
    digital_input,
    estimator,
    feedforward,
    lqg,
    pid,
    reference,
    sensor,
    shaping,
    steady,
)

_C_TYPES = {"float64": "double", "int64": "int64_t", "int32": "int32_t"}
_ENUMERATIONS = (record, records, states, estimator)
_REASONS = ("DEMAND_AHEAD", "MISSING", "GAUGE_LOST", "STAGE_LOST", "DEVICE_BEHIND", "INNER_CALM", "FOUND")
_SINGLE = (
    (reference, ("SIGNAL", "JOG", "MAX_MODES", "REFERENCE_STATES", "STOOD_STILL")),
    (steady, ("SURE_NATS", "LOST_NATS", "ANEW_NATS", "FAR_SIGMA")),
    (supervisor, ("BEHIND", "FOLLOWED", "RELAPSED", "MANY", "AT_ONCE", "REMEMBERED", *_REASONS)),
)
_LAWS = (digital_input, shaping, feedforward, pid, estimator, lqg, reference, sensor, coordinate_transform)
_RECORDS = (
    *_LAWS,
    limit_cycle,
    oscillation,
    watch,
    arming,
    axis_order,
    faults,
    figures,
    reference_blend,
    supervisor,
    records,
    telemetry,
)
"""What is part of another record comes before it."""


def header() -> str:
    """The text of ``records.h``."""
    lines = ["/* Generated from micromanip.rt by benchmarks/layout.py. */", "#ifndef RECORDS_H", "#define RECORDS_H"]
    lines += ["#include <stddef.h>", "#include <stdint.h>", ""]
    lines += [f"#define {name} {value}" for name, value in _constants().items()]
    known: dict[str, np.dtype[Any]] = {}
    for name, value in (entry for module in _RECORDS for entry in vars(module).items()):
        if isinstance(value, np.dtype) and value.names and name.lower() not in known:
            lines += ["", *_structure(name.lower(), value, known)]
            known[name.lower()] = value
    return "\n".join([*lines, "", "#endif", ""])


def write_header(folder: Path) -> Path:
    """Write ``records.h`` into `folder`."""
    file = folder / "records.h"
    file.write_text(header(), encoding="utf-8")
    return file


def _constants() -> dict[str, float]:
    found = {
        name: value
        for module in _ENUMERATIONS
        for name, value in vars(module).items()
        if name.isupper() and isinstance(value, int)
    }
    return found | {name: getattr(module, name) for module, names in _SINGLE for name in names}


def _structure(name: str, dtype: np.dtype[Any], known: dict[str, np.dtype[Any]]) -> Iterator[str]:
    assert dtype.names is not None
    assert dtype.fields is not None
    yield f"struct {name} {{"
    for field_name in dtype.names:
        element = dtype.fields[field_name][0]
        sizes = "".join(f"[{size}]" for size in element.shape)
        yield f"    {_type_name(element.base, known)} {field_name}{sizes};"
    yield "};"
    yield f'_Static_assert(sizeof(struct {name}) == {dtype.itemsize}, "size of {name}");'
    for field_name in dtype.names:
        offset = dtype.fields[field_name][1]
        yield f'_Static_assert(offsetof(struct {name}, {field_name}) == {offset}, "place of {name}.{field_name}");'


def _type_name(dtype: np.dtype[Any], known: dict[str, np.dtype[Any]]) -> str:
    if dtype.names is None:
        return _C_TYPES[dtype.name]
    return next(f"struct {name}" for name, other in known.items() if other == dtype)
