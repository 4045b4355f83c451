"""Telemetry rows as blocks of columns that compress well, bit for bit what they were.

A float's last bits are noise, and no compressor shortens noise. But a smooth signal goes on as it went: differences of
integers, up to the fourth, are small. They are written byte plane by byte plane, because the high bytes are alike. The
format: docs/record-and-replay.md.
"""

from __future__ import annotations

import struct
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

_ORDERS = 5
"""Differences of order 0 to 4 are tried."""
_PLANES = 8
_SEARCH_EVERY = 20
"""Blocks: how quickly a column may become smooth, or rough, without its order following."""
_HEAD = struct.Struct("<II")
"""Rows and columns; then an order a column, and the planes."""
_MAGNITUDE = np.int64(0x7FFF_FFFF_FFFF_FFFF)
_Bits = NDArray[np.int64]


class Column(NamedTuple):
    """Place of a column in a row: `path` is its name, ``axis.0.voltage_V`` in an array of records."""

    path: str
    format: str
    offset: int


def columns_of_rows(dtype: np.dtype[Any]) -> list[Column]:
    """Every number of a record, in order. ValueError for anything but integers and floats of 4 and 8 bytes."""
    found: list[Column] = []
    fields: Mapping[str, Any] = dtype.fields or {}
    for name in fields:
        field, offset = fields[name][:2]
        base, shape = field.subdtype if field.subdtype is not None else (field, ())
        for k in range(int(np.prod(shape))):
            path = f"{name}.{k}" if shape else name
            at = offset + k * base.itemsize
            if base.names:
                found += [Column(f"{path}.{c.path}", c.format, at + c.offset) for c in columns_of_rows(base)]
            elif base.str in ("<i4", "<i8", "<f8"):
                found.append(Column(path, base.str, at))
            else:
                raise ValueError(f"{path}: {base.str} is no column of a block")
    return found


def record_of(columns: Sequence[Column], row_bytes: int) -> np.dtype[Any]:
    """The record that has these columns: what `columns_of_rows` takes apart. ValueError where there is none."""
    groups: dict[str, list[Column]] = {}
    for column in columns:
        groups.setdefault(column.path.partition(".")[0], []).append(column)
    starts = [members[0].offset for members in groups.values()]
    formats: list[Any] = []
    for members, start, end in zip(groups.values(), starts, [*starts[1:], row_bytes], strict=True):
        if len(members) == 1 and "." not in members[0].path:
            formats.append(members[0].format)
            continue
        count = 1 + max(int(member.path.split(".")[1]) for member in members)
        size = (end - start) // count
        first = [m for m in members if m.path.split(".")[1] == "0"]
        inner = [Column(m.path.split(".", 2)[2], m.format, m.offset - start) for m in first if m.path.count(".") > 1]
        formats.append((record_of(inner, size) if inner else first[0].format, (count,)))
    described = {"names": list(groups), "formats": formats, "offsets": starts, "itemsize": row_bytes}
    return np.dtype(described)  # type: ignore[call-overload,no-any-return]  # made of variables


class BlockCodec:
    """Rows to blocks and back. A block stands alone: it can be read without those before it."""

    def __init__(self, columns: Sequence[Column], row_bytes: int) -> None:
        self.columns, self.row_bytes = list(columns), row_bytes
        self._index = {column.path: k for k, column in enumerate(self.columns)}
        self._floats = np.array([column.format == "<f8" for column in self.columns])
        self._orders = np.zeros(len(self.columns), np.uint8)
        self._blocks = 0

    @classmethod
    def of(cls, dtype: np.dtype[Any]) -> BlockCodec:
        """The codec of rows of `dtype`."""
        return cls(columns_of_rows(dtype), dtype.itemsize)

    @classmethod
    def described(cls, document: Mapping[str, Any]) -> BlockCodec:
        """The codec that wrote a file, by its schema. KeyError, TypeError, ValueError where it is none."""
        if document["layout"] != "micromanip.block/1":
            raise ValueError(f"layout {document['layout']!r:.60} is not known here")
        columns = [Column(str(c["name"]), str(c["type"]), int(c["offset"])) for c in document["columns"]]
        return cls(columns, int(document["row_bytes"]))

    def document(self) -> dict[str, Any]:
        """What a reader must know, as JSON."""
        return {
            "layout": "micromanip.block/1",
            "row_bytes": self.row_bytes,
            "columns": [{"name": c.path, "type": c.format, "offset": c.offset} for c in self.columns],
        }

    @property
    def dtype(self) -> np.dtype[Any]:
        """The record whose rows were written."""
        return record_of(self.columns, self.row_bytes)

    def encode(self, rows: NDArray[Any]) -> bytes:
        """A block of `rows` (n,), at least one, of the dtype the codec was made of."""
        raw = np.ascontiguousarray(rows).view(np.uint8).reshape(len(rows), self.row_bytes)
        width = len(self.columns)
        bits = np.empty((width, len(rows)), np.int64)
        for k, column in enumerate(self.columns):
            size = int(column.format[2])
            part = np.ascontiguousarray(raw[:, column.offset : column.offset + size])
            bits[k] = part.view(f"<i{size}")[:, 0]
        bits[self._floats] = _ordered(bits[self._floats])
        if self._blocks % _SEARCH_EVERY == 0:
            self._orders = _best_orders(bits)
        self._blocks += 1
        for order in range(1, _ORDERS):
            chosen = self._orders == order
            if chosen.any():
                bits[chosen] = _zigzag(_difference(bits[chosen], order))
        planes = np.ascontiguousarray(bits.view(np.uint8).reshape(width, len(rows), _PLANES).transpose(0, 2, 1))
        return b"".join([_HEAD.pack(len(rows), width), self._orders.tobytes(), planes.tobytes()])

    def decode(self, block: bytes, paths: Sequence[str] | None = None) -> dict[str, NDArray[Any]]:
        """Columns (n,) of a block by their path, all or those of `paths`.

        ValueError where it is no block of this codec, or has no such column.
        """
        if missing := [path for path in paths or () if path not in self._index]:
            raise ValueError(f"its rows have no {missing[0]}")
        if len(block) < _HEAD.size:
            raise ValueError("a block is cut off")
        count, width = _HEAD.unpack_from(block)
        at = _HEAD.size + width
        if width != len(self.columns) or len(block) != at + count * width * _PLANES:
            raise ValueError("a block does not fit its schema")
        wanted = list(range(width)) if paths is None else [self._index[path] for path in paths]
        orders = np.frombuffer(block, np.uint8, width, _HEAD.size)[wanted]
        planes = np.frombuffer(block, np.uint8, offset=at).reshape(width, _PLANES, count)[wanted]
        bits = np.ascontiguousarray(planes.transpose(0, 2, 1)).view(np.int64)[:, :, 0]
        for order in range(1, _ORDERS):
            chosen = orders == order
            if chosen.any():
                bits[chosen] = _summed(_unzigzag(bits[chosen]), order)
        floats = self._floats[wanted]
        bits[floats] = _ordered(bits[floats])
        return {
            self.columns[k].path: _typed(each, self.columns[k].format) for k, each in zip(wanted, bits, strict=True)
        }

    def rows(self, block: bytes) -> NDArray[Any]:
        """All of a block as rows (n,) of `dtype`."""
        names, formats, offsets = zip(*self.columns, strict=True)
        flat = np.dtype({"names": names, "formats": formats, "offsets": offsets, "itemsize": self.row_bytes})
        columns = self.decode(block)
        rows = np.zeros(len(next(iter(columns.values()))), flat)
        for path, values in columns.items():
            rows[path] = values
        return rows.view(self.dtype)


def _typed(bits: _Bits, kind: str) -> NDArray[Any]:
    return bits.view(np.float64) if kind == "<f8" else bits.astype(kind)


def _ordered(bits: _Bits) -> _Bits:
    """Negative floats run backwards as integers: turned round, or, as this undoes itself, back."""
    return bits ^ ((bits >> 63) & _MAGNITUDE)


def _difference(bits: _Bits, order: int) -> _Bits:
    for _ in range(order):
        bits = np.diff(bits, axis=1, prepend=np.int64(0))
    return bits


def _summed(bits: _Bits, order: int) -> _Bits:
    for _ in range(order):
        bits = np.cumsum(bits, axis=1)
    return bits


def _zigzag(bits: _Bits) -> _Bits:
    """Small numbers of either sign to small ones without."""
    return (bits << 1) ^ (bits >> 63)


def _unzigzag(bits: _Bits) -> _Bits:
    unsigned = bits.view(np.uint64)
    return ((unsigned >> np.uint64(1)) ^ (np.uint64(0) - (unsigned & np.uint64(1)))).view(np.int64)


def _best_orders(bits: _Bits) -> NDArray[np.uint8]:
    """For each column the order whose byte planes have the least entropy."""
    entropies = []
    for order in range(_ORDERS):
        coded = bits if order == 0 else _zigzag(_difference(bits, order))
        entropies.append(_entropy(coded))
    return np.asarray(np.argmin(entropies, axis=0), np.uint8)


def _entropy(bits: _Bits) -> NDArray[np.float64]:
    """Bits a value that an entropy coder of each byte plane would take, by column."""
    columns, count = bits.shape
    place = np.arange(columns * _PLANES).reshape(columns, 1, _PLANES) * 256
    values = np.ascontiguousarray(bits).view(np.uint8).reshape(columns, count, _PLANES) + place
    counts = np.bincount(values.ravel(), minlength=columns * _PLANES * 256).reshape(columns, -1)
    terms = np.where(counts > 0, counts * np.log2(np.maximum(counts, 1)), 0.0)
    return np.asarray(_PLANES * np.log2(count) - terms.sum(axis=1) / count, float)
