"""MCAP of other programs: the numbers in messages of JSON, as columns ``TOPIC.field``, one row per message.

A field within another is ``outer.inner``, an element of a list ``name[0]``; what a message lacks is NaN. Beside them
stands ``TOPIC.log_time``, s since the file's first message. Other encodings need their own libraries, and are named.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from mcap.exceptions import McapError
from mcap.reader import make_reader

from micromanip.errors import CheckFailed

from .table import Array, Table

_JSON = "json"


def read_foreign(file: Path) -> Table:
    """The columns of all topics; the clock of each is its ``log_time``. CheckFailed where there are no numbers."""
    rows: dict[str, list[dict[str, float]]] = {}
    times_ns: dict[str, list[int]] = {}
    others: dict[str, str] = {}
    try:
        with file.open("rb") as stream:
            for _, channel, message in make_reader(stream, validate_crcs=True).iter_messages():
                if channel.message_encoding != _JSON:
                    others[channel.topic] = channel.message_encoding or "no encoding"
                    continue
                rows.setdefault(channel.topic, []).append(dict(_numbers("", json.loads(message.data))))
                times_ns.setdefault(channel.topic, []).append(message.log_time)
    except (McapError, ValueError, OSError, EOFError, OverflowError, RecursionError) as problem:
        raise CheckFailed(f"{file}: it is cut off, damaged, or no MCAP with messages of JSON ({problem})") from problem
    columns: dict[str, Array] = {}
    clocks: dict[str, str] = {}
    begin_ns = min((times[0] for times in times_ns.values()), default=0)
    for topic, messages in rows.items():
        if fields := list(dict.fromkeys(field for message in messages for field in message)):
            clock = f"{topic}.log_time"
            columns[clock] = np.asarray(1e-9 * (np.array(times_ns[topic], np.int64) - begin_ns), np.float64)
            for field in fields:
                columns[f"{topic}.{field}"] = np.array([message.get(field, np.nan) for message in messages], np.float64)
            clocks |= dict.fromkeys((clock, *(f"{topic}.{field}" for field in fields)), clock)
    if not columns:
        others |= dict.fromkeys(rows, "json without numbers")
        told = ", ".join(f"{topic} ({encoding})" for topic, encoding in list(others.items())[:8]) or "no messages"
        raise CheckFailed(
            f"{file}: neither telemetry of ours nor messages of JSON with numbers in it; it has {told}. Write what is "
            "wanted as JSON, or export it as CSV or Parquet"
        )
    return Table(file, columns, dict.fromkeys(clocks.values(), "s"), clocks=clocks)


def _numbers(name: str, value: Any) -> Iterator[tuple[str, float]]:
    """Each number within `value` by its name."""
    if isinstance(value, dict):
        for key, inner in value.items():
            yield from _numbers(f"{name}.{key}" if name else key, inner)
    elif isinstance(value, list):
        for k, inner in enumerate(value):
            yield from _numbers(f"{name}[{k}]", inner)
    elif isinstance(value, int | float):
        yield name or "value", float(value)
