"""Recordings of ours in MCAP, also those whose writer was killed, and those that are still being written.

The file is walked record by record from its beginning, so that no index is needed; where it ends within a
record, it ends before it.
"""

from __future__ import annotations

import contextlib
import io
import json
import os
import struct
from collections.abc import Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from micromanip.errors import CheckFailed

from . import mcap_layout as layout
from .blocks import BlockCodec
from .table import Table
from .telemetry import Piece, Rows, Telemetry

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
            pieces=partial(_pieces, file, codec),
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
    for _, found in _chunks_of_blocks(file):
        yield from found


def _chunks_of_blocks(file: Path) -> Iterator[tuple[tuple[int, int, int], list[bytes]]]:
    """What each chunk with blocks holds, and where it is: place and length in the file, number of their channel."""
    channel = None
    with file.open("rb") as again:
        for opcode, content in _records(file, again):
            if opcode == _CHUNK:
                at, records = again.tell(), _chunk(file, content)
                channel = next((r.id for r in records if getattr(r, "topic", "") == layout.BLOCKS_TOPIC), channel)
                if channel is not None and (found := _on_channel(records, channel)):
                    yield (at - len(content), len(content), channel), found


def _on_channel(records: Sequence[Any], channel: int) -> list[bytes]:
    return [record.data for record in records if getattr(record, "channel_id", None) == channel and _is_message(record)]


def _is_message(record: Any) -> bool:
    return hasattr(record, "sequence")


def _pieces(file: Path, codec: BlockCodec) -> Iterator[Piece]:
    for place, found in _chunks_of_blocks(file):
        try:
            for number, data in enumerate(found):
                yield Piece(codec.rows(data), partial(_again, file, codec, place, number))
        except ValueError as problem:
            raise CheckFailed(f"{file}: {_WHY} ({problem})") from problem


def _again(
    file: Path, codec: BlockCodec, place: tuple[int, int, int], number: int, paths: Sequence[str]
) -> dict[str, NDArray[Any]]:
    at, length, channel = place
    with file.open("rb") as stream:
        stream.seek(at)
        content = stream.read(length)
    try:
        return codec.decode(_on_channel(_chunk(file, content), channel)[number], paths)
    except (ValueError, IndexError) as problem:
        raise CheckFailed(f"{file}: it has changed since it was opened ({problem})") from problem


def _has_marks(content: bytes) -> bool:
    """Whether a chunk may hold remarks: the recorder gives each a chunk of its own, and those are short."""
    return len(content) < 4096


def _described(file: Path, schema: bytes) -> BlockCodec:
    try:
        return BlockCodec.described(json.loads(schema))
    except (KeyError, TypeError, ValueError) as problem:
        raise CheckFailed(f"{file}: {_WHY} ({problem})") from problem


def _records(file: Path, opened: IO[bytes] | None = None) -> Iterator[tuple[int, bytes]]:
    """Metadata, attachments and chunks that are there as a whole, up to the index; `opened` stands behind each."""
    with contextlib.nullcontext(opened) if opened is not None else file.open("rb") as stream:
        size = os.fstat(stream.fileno()).st_size
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
