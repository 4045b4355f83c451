"""Recordings of ours in MCAP, also those whose writer was killed, and those that are still being written."""

from __future__ import annotations

import io
import json
import struct
import zipfile
import zlib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from micromanip.errors import CheckFailed

from . import mcap_layout as layout
from .blocks import BlockCodec
from .foreign_mcap import read_foreign
from .mcap_places import (
    ATTACHMENT,
    CHUNK,
    MESSAGE,
    METADATA,
    RECORD,
    SCHEMA,
    begins_without_chunks,
    declared,
    places,
    whole_records,
)
from .table import Table
from .telemetry import Piece, Rows, Telemetry

_MESSAGE_HEAD = struct.Struct("<HIQQ")
"""Number of the channel, sequence, and two times, before what a message holds."""
_SHORT_CHUNK = 4096
_CHECKSUM_BYTES = 4
_ZIP, _MOST_UNPACKED = b"PK", 100_000_000
_WHY = "it is damaged, or not a recording of ours"


class NotOursError(CheckFailed):
    """A whole MCAP file of another program."""


def read_mcap(file: Path) -> Table:
    """The columns of a recording, or of messages that another program wrote. CheckFailed where it is damaged."""
    try:
        telemetry = open_mcap(file)
    except NotOursError:
        return read_foreign(file)
    return telemetry.table()


def open_mcap(file: Path) -> Telemetry:
    """What a recording is of. CheckFailed where it is damaged, or of another program; the rows are read later."""
    metadata: dict[str, dict[str, str]] = {}
    attachments: dict[str, bytes] = {}
    damaged: list[str] = []
    marks: list[dict[str, Any]] = []
    codec: BlockCodec | None = None
    chunked = False
    topics: dict[int, str] = {}

    def take_in(records: Iterable[Any]) -> None:
        nonlocal codec
        for record in records:
            if getattr(record, "encoding", None) == layout.BLOCKS_ENCODING:
                codec = _described(file, record.data)
            elif hasattr(record, "topic"):
                topics[record.id] = record.topic
            elif topics.get(getattr(record, "channel_id", 0)) == layout.MARKS_TOPIC:
                marks.append(json.loads(record.data))

    with file.open("rb") as stream:
        take_in(_declared(file, stream))
        for opcode, length in places(stream):
            if opcode == METADATA:
                record = _parsed(file, "Metadata", stream.read(length))
                metadata[record.name] = record.metadata
            elif opcode == ATTACHMENT:
                content = stream.read(length)
                if _is_whole(content):
                    record = _parsed(file, "Attachment", content)
                    attachments[record.name] = record.data
                else:
                    damaged.append(_name(content))
            elif codec is None or not chunked or length < _SHORT_CHUNK:  # a remark has a chunk of its own
                chunked = True
                take_in(_chunk(file, stream.read(length), sure=codec is None))
    if codec is None or layout.ABOUT not in metadata or not chunked:
        if begins_without_chunks(file):
            raise CheckFailed(f"{file}: its messages are in no chunks; `mcap compress` writes a copy that can be read")
        raise NotOursError(f"{file}: an MCAP file without telemetry of ours, topic {layout.BLOCKS_TOPIC}")
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
            parameters=[_sure(file, *each) for each in attachments.items() if each[0].startswith(layout.PARAMETERS)],
            states=[_sure(file, *each) for each in attachments.items() if each[0].startswith(layout.STATES)],
            marks=marks,
            samples=_array(file, attachments, layout.SAMPLES),
            sources=about.get("sources", ""),
            damaged=damaged,
        )
    except (KeyError, ValueError) as problem:
        raise CheckFailed(f"{file}: {_WHY} ({problem})") from problem


def _value(text: str) -> Any:
    return int(text) if text.isdigit() else text == "true" if text in ("true", "false") else text


def _array(file: Path, attachments: Mapping[str, bytes], name: str) -> NDArray[Any] | None:
    return _sure(file, name, attachments[name]) if name in attachments else None


def _is_whole(attachment: bytes) -> bool:
    """By the checksum at its end, of all before; 0 where its writer made none."""
    told = int.from_bytes(attachment[-_CHECKSUM_BYTES:], "little")
    return told in (0, zlib.crc32(attachment[:-_CHECKSUM_BYTES]))


def _name(attachment: bytes) -> str:
    """Of a damaged one, as far as it can be read."""
    size, begins = int.from_bytes(attachment[16:20], "little"), 20
    return ascii(attachment[begins : begins + min(size, 40)].decode(errors="replace")).strip("'") or "an attachment"


def _sure(file: Path, name: str, data: bytes) -> NDArray[Any]:
    try:
        return _unpacked(data) if data.startswith(_ZIP) else np.load(io.BytesIO(data), allow_pickle=False)
    except (ValueError, OSError, EOFError, zipfile.BadZipFile, zlib.error, RuntimeError) as problem:
        # NumPy's words have all of a record in them
        raise CheckFailed(f"{file}: {_WHY} (its attachment {name} can't be read)") from problem


def _unpacked(data: bytes) -> NDArray[Any]:
    """The only array of a file that ``numpy.savez_compressed`` has made. ValueError and others where it is none."""
    with zipfile.ZipFile(io.BytesIO(data)) as packed:
        (entry,) = packed.infolist()
        if entry.file_size > _MOST_UNPACKED:
            raise ValueError("it unpacks to too much")
        found: NDArray[Any] = np.load(io.BytesIO(packed.read(entry)), allow_pickle=False)
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
    with file.open("rb") as stream:
        channel = _channel(_declared(file, stream), None)
    for opcode, content in whole_records(file):
        if opcode == CHUNK:
            records = _chunk(file, content)
            channel = _channel(records, channel)
            if channel is not None:
                yield from _on_channel(records, channel)


def _channel(records: Iterable[Any], known: int | None) -> int | None:
    """Number of the channel with blocks, if it is among `records`."""
    return next((r.id for r in records if getattr(r, "topic", "") == layout.BLOCKS_TOPIC), known)


def _on_channel(records: Sequence[Any], channel: int) -> list[bytes]:
    """What the messages among `records` hold that are on this channel."""
    return [r.data for r in records if getattr(r, "channel_id", None) == channel and hasattr(r, "sequence")]


def _pieces(file: Path, codec: BlockCodec) -> list[Piece]:
    """The chunks with rows, by their places: what is long enough to be one is looked into when it is read."""
    found: list[Piece] = []
    with file.open("rb") as stream:
        channel = _channel(_declared(file, stream), None)
        for opcode, length in places(stream):
            if opcode != CHUNK:
                continue
            at = stream.tell()
            if channel is None or length < _SHORT_CHUNK:
                records = _chunk(file, stream.read(length), sure=channel is None)
                channel = _channel(records, channel)
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
        while at + RECORD.size <= len(records):
            opcode, length = RECORD.unpack_from(records, at)
            at += RECORD.size
            if opcode == MESSAGE and _MESSAGE_HEAD.unpack_from(records, at)[0] == channel:
                yield records[at + _MESSAGE_HEAD.size : at + length]
            at += length
    else:
        yield from _on_channel(_chunk(file, content), channel)


def _described(file: Path, schema: bytes) -> BlockCodec:
    try:
        return BlockCodec.described(json.loads(schema))
    except (KeyError, TypeError, ValueError) as problem:
        raise CheckFailed(f"{file}: {_WHY} ({problem})") from problem


def _declared(file: Path, stream: IO[bytes]) -> list[Any]:
    return [_parsed(file, "Schema" if kind == SCHEMA else "Channel", content) for kind, content in declared(stream)]


def _parsed(file: Path, kind: str, content: bytes) -> Any:
    records, data_stream = _library()
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


def _library() -> tuple[Any, Any]:
    from mcap import data_stream, records

    return records, data_stream


def _failure() -> type[Exception]:
    from mcap.exceptions import McapError

    return McapError
