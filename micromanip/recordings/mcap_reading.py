"""Recordings of ours in MCAP, also those whose writer was killed, and those that are still being written.

The file is walked record by record from its beginning, so that no index is needed; where it ends within a
record, it ends before it.
"""

from __future__ import annotations

import io
import json
import struct
from collections.abc import Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from micromanip.errors import CheckFailed

from . import mcap_layout as layout
from .blocks import BlockCodec
from .table import Table
from .telemetry import Rows, Telemetry

MAGIC = b"\x89MCAP0\r\n"
_RECORD = struct.Struct("<BQ")
_METADATA, _ATTACHMENT, _CHUNK, _DATA_END = 0x0C, 0x09, 0x06, 0x0F
_WHY = "it is damaged, or not a recording of ours"


def read_mcap(file: Path) -> Table:
    """The columns of a recording. CheckFailed where it is damaged, or of another program."""
    return open_mcap(file).table()


def open_mcap(file: Path) -> Telemetry:
    """What a recording is of. CheckFailed where it is damaged, or of another program; the rows are read later."""
    metadata: dict[str, dict[str, str]] = {}
    attachments: dict[str, bytes] = {}
    marks: list[dict[str, Any]] = []
    codec: BlockCodec | None = None
    topics: dict[int, str] = {}
    for opcode, content in _records(file):
        if opcode == _METADATA:
            record = _parsed(file, "Metadata", content)
            metadata[record.name] = record.metadata
        elif opcode == _ATTACHMENT:
            record = _parsed(file, "Attachment", content)
            attachments[record.name] = record.data
        elif codec is None or _has_marks(content):
            for record in _chunk(file, content):
                if getattr(record, "encoding", None) == layout.BLOCKS_ENCODING:
                    codec = _described(file, record.data)
                elif hasattr(record, "topic"):
                    topics[record.id] = record.topic
                elif topics.get(getattr(record, "channel_id", 0)) == layout.MARKS_TOPIC:
                    marks.append(json.loads(record.data))
    if codec is None or layout.ABOUT not in metadata:
        raise CheckFailed(f"{file}: an MCAP file without telemetry of ours, topic {layout.BLOCKS_TOPIC}")
    about, end = metadata[layout.ABOUT], metadata.get(layout.END, {})
    try:
        return Telemetry(
            file,
            axes=json.loads(about["axes"]),
            period_ns=int(about["period_ns"]),
            dtype=codec.dtype,
            configuration=attachments.get(layout.CONFIGURATION, b"").decode(),
            sha256=about["sha256"],
            end={key: _value(value) for key, value in end.items()},
            parts=partial(_parts, file, codec),
            rows=partial(_rows, file, codec),
            state=_array(attachments.get(layout.STATE)),
            parameters=[_sure(data) for name, data in attachments.items() if name.startswith("parameters-")],
            states=[_sure(data) for name, data in attachments.items() if name.startswith(layout.STATES)],
            marks=marks,
            samples=_array(attachments.get(layout.SAMPLES)),
            sources=about.get("sources", ""),
        )
    except (KeyError, ValueError) as problem:
        raise CheckFailed(f"{file}: {_WHY} ({problem})") from problem


def _value(text: str) -> Any:
    return int(text) if text.isdigit() else text == "true" if text in ("true", "false") else text


def _array(data: bytes | None) -> NDArray[Any] | None:
    return None if data is None else _sure(data)


def _sure(data: bytes) -> NDArray[Any]:
    found: NDArray[Any] = np.load(io.BytesIO(data), allow_pickle=False)
    return found


def _parts(file: Path, codec: BlockCodec, paths: Sequence[str]) -> Rows:
    for data in _blocks(file):
        try:
            yield codec.decode(data, paths)
        except ValueError as problem:
            raise CheckFailed(f"{file}: {_WHY} ({problem})") from problem


def _rows(file: Path, codec: BlockCodec) -> Iterator[NDArray[Any]]:
    for data in _blocks(file):
        try:
            yield codec.rows(data)
        except ValueError as problem:
            raise CheckFailed(f"{file}: {_WHY} ({problem})") from problem


def _blocks(file: Path) -> Iterator[bytes]:
    """The messages with blocks, in order."""
    channel = None
    for opcode, content in _records(file):
        if opcode == _CHUNK:
            for record in _chunk(file, content):
                if getattr(record, "topic", None) == layout.BLOCKS_TOPIC:
                    channel = record.id
                elif channel is not None and getattr(record, "channel_id", None) == channel:
                    yield record.data


def _has_marks(content: bytes) -> bool:
    """Whether a chunk may hold remarks: the recorder gives each a chunk of its own, and those are short."""
    return len(content) < 4096


def _described(file: Path, schema: bytes) -> BlockCodec:
    try:
        return BlockCodec.described(json.loads(schema))
    except (KeyError, TypeError, ValueError) as problem:
        raise CheckFailed(f"{file}: {_WHY} ({problem})") from problem


def _records(file: Path) -> Iterator[tuple[int, bytes]]:
    """Metadata, attachments and chunks that are there as a whole, up to the index."""
    size = file.stat().st_size
    with file.open("rb") as stream:
        at = len(stream.read(len(MAGIC)))
        while at + _RECORD.size <= size:
            opcode, length = _RECORD.unpack(stream.read(_RECORD.size))
            at += _RECORD.size + length
            if opcode == _DATA_END or at > size:
                return
            if opcode in (_METADATA, _ATTACHMENT, _CHUNK):
                yield opcode, stream.read(length)
            else:
                stream.seek(at)


def _parsed(file: Path, kind: str, content: bytes) -> Any:
    records, data_stream = _library(file)
    try:
        return getattr(records, kind).read(data_stream.ReadDataStream(io.BytesIO(content)))
    except (ValueError, struct.error, _failure()) as problem:
        raise CheckFailed(f"{file}: {_WHY} ({problem})") from problem


def _chunk(file: Path, content: bytes) -> list[Any]:
    """The records in a chunk; its checksum is looked at."""
    from mcap.stream_reader import breakup_chunk

    chunk = _parsed(file, "Chunk", content)
    try:
        return list(breakup_chunk(chunk, validate_crc=True))
    except Exception as problem:  # whatever the decompressors raise
        raise CheckFailed(f"{file}: {_WHY} ({problem})") from problem


def _library(file: Path) -> tuple[Any, Any]:
    try:
        from mcap import data_stream, records
    except ImportError as problem:
        raise CheckFailed(f"{file}: reading MCAP needs the extra: pip install micromanip[recording]") from problem
    return records, data_stream


def _failure() -> type[Exception]:
    from mcap.exceptions import McapError

    return McapError
