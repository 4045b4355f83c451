"""Recordings of ours in MCAP, also those whose writer was killed, and those that are still being written.

A file with its index at the end is read by that; any other is walked record by record from its beginning, and where it
ends within a record, it ends before it.
"""

from __future__ import annotations

import io
import json
import os
import struct
import zlib
from collections.abc import Iterator, Mapping, Sequence
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
_METADATA, _ATTACHMENT, _CHUNK, _DATA_END, _MESSAGE, _CHANNEL = 0x0C, 0x09, 0x06, 0x0F, 0x05, 0x04
_MESSAGE_HEAD = struct.Struct("<HIQQ")
"""Number of the channel, sequence, and two times, before what a message holds."""
_SHORT_CHUNK = 4096
_FOOTER_RECORD, _FOOTER = 0x02, struct.Struct("<BQQQI8s")
"""Kind, length, beginning of the summary, that of its offsets, checksum; then what a file ends with."""
_INDEX_RECORDS = {0x08: (_CHUNK, 16), 0x0A: (_ATTACHMENT, 0), 0x0D: (_METADATA, 0)}
"""Records of the index: what they are of, and how many bytes of theirs are before its place and length."""
_PLACE = struct.Struct("<QQ")
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
    with file.open("rb") as stream:
        for opcode, length in _places(stream):
            if opcode == _METADATA:
                record = _parsed(file, "Metadata", stream.read(length))
                metadata[record.name] = record.metadata
            elif opcode == _ATTACHMENT:
                record = _parsed(file, "Attachment", stream.read(length))
                attachments[record.name] = record.data
            elif codec is None or length < _SHORT_CHUNK:  # a remark has a chunk of its own
                for record in _chunk(file, stream.read(length), sure=codec is None):
                    if getattr(record, "encoding", None) == layout.BLOCKS_ENCODING:
                        codec = _described(file, record.data)
                    elif hasattr(record, "topic"):
                        topics[record.id] = record.topic
                    elif topics.get(getattr(record, "channel_id", 0)) == layout.MARKS_TOPIC:
                        marks.append(json.loads(record.data))
    if codec is None or layout.ABOUT not in metadata:
        if _begins_without_chunks(file):
            raise CheckFailed(f"{file}: its messages are in no chunks; `mcap compress` writes a copy that can be read")
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
            state=_array(file, attachments, layout.STATE),
            parameters=[_sure(file, *each) for each in attachments.items() if each[0].startswith("parameters-")],
            states=[_sure(file, *each) for each in attachments.items() if each[0].startswith(layout.STATES)],
            marks=marks,
            samples=_array(file, attachments, layout.SAMPLES),
            sources=about.get("sources", ""),
        )
    except (KeyError, ValueError) as problem:
        raise CheckFailed(f"{file}: {_WHY} ({problem})") from problem


def _value(text: str) -> Any:
    return int(text) if text.isdigit() else text == "true" if text in ("true", "false") else text


def _array(file: Path, attachments: Mapping[str, bytes], name: str) -> NDArray[Any] | None:
    return _sure(file, name, attachments[name]) if name in attachments else None


def _sure(file: Path, name: str, data: bytes) -> NDArray[Any]:
    try:
        found: NDArray[Any] = np.load(io.BytesIO(data), allow_pickle=False)
    except (ValueError, OSError, EOFError) as problem:  # NumPy's words have all of a record in them
        raise CheckFailed(f"{file}: {_WHY} (its attachment {name} can't be read)") from problem
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
            records = _chunk(file, content)
            channel = next((r.id for r in records if getattr(r, "topic", "") == layout.BLOCKS_TOPIC), channel)
            if channel is not None:
                yield from _on_channel(records, channel)


def _on_channel(records: Sequence[Any], channel: int) -> list[bytes]:
    """What the messages among `records` hold that are on this channel."""
    return [r.data for r in records if getattr(r, "channel_id", None) == channel and hasattr(r, "sequence")]


def _pieces(file: Path, codec: BlockCodec) -> list[Piece]:
    """The chunks with rows, by their places: what is long enough to be one is looked into when it is read."""
    channel: int | None = None
    found: list[Piece] = []
    with file.open("rb") as stream:
        for opcode, length in _places(stream):
            if opcode != _CHUNK:
                continue
            at = stream.tell()
            if channel is None or length < _SHORT_CHUNK:
                records = _chunk(file, stream.read(length), sure=channel is None)
                channel = next((r.id for r in records if getattr(r, "topic", "") == layout.BLOCKS_TOPIC), channel)
                if channel is None or (records and not _on_channel(records, channel)):
                    continue
            found.append(partial(_piece, file, codec, at, length, channel))
    return found


def _piece(
    file: Path, codec: BlockCodec, at: int, length: int, channel: int, paths: Sequence[str]
) -> dict[str, NDArray[Any]]:
    with file.open("rb") as stream:
        stream.seek(at)
        content = stream.read(length)
    try:
        blocks = [codec.decode(data, paths) for data in _messages(file, content, channel)]
        none = [np.empty(0, np.int64)] if not blocks else []  # another program puts chunks without rows between ours
        return {path: np.concatenate(none or [block[path] for block in blocks]) for path in paths}
    except (ValueError, struct.error) as problem:
        raise CheckFailed(f"{file}: it is damaged here, or has changed since it was opened ({problem})") from problem


def _messages(file: Path, content: bytes, channel: int) -> Iterator[bytes]:
    """What the messages of a channel hold in a chunk: a tenth of what the library takes, which makes all records."""
    chunk = _parsed(file, "Chunk", content)
    if chunk.compression == "zstd":
        import zstandard

        try:
            records = zstandard.ZstdDecompressor().decompress(chunk.data, chunk.uncompressed_size)
        except zstandard.ZstdError as problem:
            raise ValueError(problem) from problem
        if chunk.uncompressed_crc and chunk.uncompressed_crc != zlib.crc32(records):
            raise ValueError("its checksum is wrong")
        at = 0
        while at + _RECORD.size <= len(records):
            opcode, length = _RECORD.unpack_from(records, at)
            at += _RECORD.size
            if opcode == _MESSAGE and _MESSAGE_HEAD.unpack_from(records, at)[0] == channel:
                yield records[at + _MESSAGE_HEAD.size : at + length]
            at += length
    else:
        yield from _on_channel(_chunk(file, content), channel)


def _described(file: Path, schema: bytes) -> BlockCodec:
    try:
        return BlockCodec.described(json.loads(schema))
    except (KeyError, TypeError, ValueError) as problem:
        raise CheckFailed(f"{file}: {_WHY} ({problem})") from problem


def _records(file: Path) -> Iterator[tuple[int, bytes]]:
    """Metadata, attachments and chunks that are there as a whole, up to the index."""
    with file.open("rb") as stream:
        for opcode, length in _places(stream):
            yield opcode, stream.read(length)


def _places(stream: IO[bytes]) -> Iterator[tuple[int, int]]:
    """Kind and length of the same; `stream` stands at the beginning of each, and may be left anywhere."""
    size = os.fstat(stream.fileno()).st_size
    if index := _index(stream, size):
        for at, opcode, length in index:
            stream.seek(at)
            yield opcode, length
        return
    at = len(MAGIC)
    while at + _RECORD.size <= size:
        stream.seek(at)
        opcode, length = _RECORD.unpack(stream.read(_RECORD.size))
        at += _RECORD.size + length
        if opcode == _DATA_END or at > size:
            return
        if opcode in (_METADATA, _ATTACHMENT, _CHUNK):
            yield opcode, length


def _begins_without_chunks(file: Path) -> bool:
    """Whether a channel comes before any chunk."""
    with file.open("rb") as stream:
        stream.seek(len(MAGIC))
        while len(head := stream.read(_RECORD.size)) == _RECORD.size:
            opcode, length = _RECORD.unpack(head)
            if opcode in (_CHUNK, _CHANNEL, _DATA_END):
                return bool(opcode == _CHANNEL)
            stream.seek(length, os.SEEK_CUR)
    return False


def _index(stream: IO[bytes], size: int) -> list[tuple[int, int, int]]:
    """Place, kind and length of the same, by the index at the end of a file that was ended in order; else nothing."""
    if size < len(MAGIC) + _FOOTER.size:
        return []
    stream.seek(size - _FOOTER.size)
    opcode, _, start, _, _, magic = _FOOTER.unpack(stream.read(_FOOTER.size))
    if opcode != _FOOTER_RECORD or magic != MAGIC or not 0 < start < size:
        return []
    stream.seek(start)
    summary, at, found = stream.read(size - _FOOTER.size - start), 0, []
    while at + _RECORD.size <= len(summary):
        opcode, length = _RECORD.unpack_from(summary, at)
        at += _RECORD.size
        if opcode in _INDEX_RECORDS and at + length <= len(summary):
            kind, skipped = _INDEX_RECORDS[opcode]
            place, whole = _PLACE.unpack_from(summary, at + skipped)
            found.append((place + _RECORD.size, kind, whole - _RECORD.size))
        at += length
    found.sort()
    for place, kind, length in found[:: max(1, len(found) - 1)]:  # the first and the last: whether it is of this file
        stream.seek(place - _RECORD.size)
        if stream.read(_RECORD.size) != _RECORD.pack(kind, length):
            return []
    return found


def _parsed(file: Path, kind: str, content: bytes) -> Any:
    records, data_stream = _library(file)
    try:
        return getattr(records, kind).read(data_stream.ReadDataStream(io.BytesIO(content)))
    except (ValueError, struct.error, _failure()) as problem:
        raise CheckFailed(f"{file}: {_WHY} ({problem})") from problem


def _chunk(file: Path, content: bytes, *, sure: bool = True) -> list[Any]:
    """The records in a chunk; its checksum is looked at. None of a damaged one that is not `sure` to be needed."""
    from mcap.stream_reader import breakup_chunk

    try:
        return list(breakup_chunk(_parsed(file, "Chunk", content), validate_crc=True))
    except Exception as problem:  # whatever the decompressors raise
        if not sure:
            return []
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
