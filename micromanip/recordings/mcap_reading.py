"""Recordings of ours in MCAP, also those whose writer was killed, and those that are still being written.

Where records stand in an MCAP file: by the index at its end, or one after another from its beginning.

A file whose writer was killed has no index; where it ends within a record, it ends before it.
"""

from __future__ import annotations

import io
import json
import os
import struct
import zipfile
import zlib
from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import IO, Any, TypeVar

import numpy as np
from mcap import data_stream, records
from mcap.exceptions import McapError
from mcap.stream_reader import get_chunk_data_stream
from numpy.typing import NDArray

from micromanip.errors import CheckFailed

from . import file_header as header
from .blocks import BlockCodec
from .table import Table
from .telemetry import Telemetry

T = TypeVar("T")
MAGIC = b"\x89MCAP0\r\n"
RECORD = struct.Struct("<BQ")
"""Kind and length, before each."""
SCHEMA, CHANNEL, MESSAGE, CHUNK, ATTACHMENT, METADATA = 0x03, 0x04, 0x05, 0x06, 0x09, 0x0C
_DATA_END = 0x0F
_FOOTER_RECORD, _FOOTER = 0x02, struct.Struct("<BQQQI8s")
"""Kind, length, beginning of the summary, that of its offsets, checksum; then what a file ends with."""
_INDEX_RECORDS = {0x08: (CHUNK, 16), 0x0A: (ATTACHMENT, 0), 0x0D: (METADATA, 0)}
"""Records of the index: what they are of, and how many bytes of theirs are before its place and length."""
_PLACE = struct.Struct("<QQ")


def places(stream: IO[bytes]) -> Iterator[tuple[int, int]]:
    """Kind and length of metadata, attachments and chunks that are there as a whole.

    `stream` stands at the beginning of each, and may be left anywhere.
    """
    if index := _index(stream):
        for at, opcode, length in index:
            stream.seek(at)
            yield opcode, length
        return
    at, size = len(MAGIC), _size(stream)
    while at + RECORD.size <= size:
        stream.seek(at)
        opcode, length = RECORD.unpack(stream.read(RECORD.size))
        at += RECORD.size + length
        if opcode == _DATA_END or at > size:
            return
        if opcode in (METADATA, ATTACHMENT, CHUNK):
            yield opcode, length


def declared(stream: IO[bytes]) -> list[tuple[int, bytes]]:
    """Schemas and channels as they stand beside the index once more: where the chunk that has them is damaged."""
    return [each for each in records_in(_summary(stream)) if each[0] in (SCHEMA, CHANNEL)] if _index(stream) else []


def records_in(content: bytes) -> Iterator[tuple[int, bytes]]:
    """Kind and content of records that stand one after another."""
    at = 0
    while at + RECORD.size <= len(content):
        opcode, length = RECORD.unpack_from(content, at)
        at += RECORD.size
        if at + length <= len(content):
            yield opcode, content[at : at + length]
        at += length


def _index(stream: IO[bytes]) -> list[tuple[int, int, int]]:
    """Place, kind and length of the same, by the index at the end of a file that was ended in order; else nothing."""
    found = []
    for opcode, content in records_in(_summary(stream)):
        if opcode in _INDEX_RECORDS:
            kind, skipped = _INDEX_RECORDS[opcode]
            place, whole = _PLACE.unpack_from(content, skipped)
            found.append((place + RECORD.size, kind, whole - RECORD.size))
    found.sort()
    for place, kind, length in found[:: max(1, len(found) - 1)]:  # the first and the last: whether it is of this file
        stream.seek(place - RECORD.size)
        if stream.read(RECORD.size) != RECORD.pack(kind, length):
            return []
    return found


def _summary(stream: IO[bytes]) -> bytes:
    """What stands at the end of a file that was ended in order; else nothing."""
    size = _size(stream)
    if size < len(MAGIC) + _FOOTER.size:
        return b""
    stream.seek(size - _FOOTER.size)
    opcode, _, start, _, _, magic = _FOOTER.unpack(stream.read(_FOOTER.size))
    if opcode != _FOOTER_RECORD or magic != MAGIC or not 0 < start < size:
        return b""
    stream.seek(start)
    return stream.read(size - _FOOTER.size - start)


def _size(stream: IO[bytes]) -> int:
    return os.fstat(stream.fileno()).st_size


_MESSAGE_HEAD = struct.Struct("<HIQQ")
"""Number of the channel, sequence, and two times, before what a message holds."""
_SHORT_CHUNK = 4096
_CHECKSUM_BYTES = 4
_ZIP, _MOST_UNPACKED = b"PK", 100_000_000
_WHY = "it is damaged, or another version of micromanip recorded it"


def read_mcap(file: Path) -> Table:
    """The columns of a recording. CheckFailed where it is damaged, or of another program."""
    return open_mcap(file).table()


def open_mcap(file: Path) -> Telemetry:
    """What a recording is of. CheckFailed where it is damaged, or of another program; the rows are read later."""
    about: dict[str, str] = {}
    end: dict[str, int] = {}
    attachments: dict[str, bytes] = {}
    damaged: list[str] = []
    marks: list[dict[str, Any]] = []
    chunks: list[tuple[int, int]] = []
    channels = _Channels(file)
    with file.open("rb") as stream:
        channels.take_in(declared(stream))
        for opcode, length in places(stream):
            if opcode == METADATA:
                found = _parsed(file, records.Metadata, stream.read(length))
                if found.name == header.ABOUT:
                    about = found.metadata
                elif found.name == header.END:
                    end = {key: int(value) for key, value in found.metadata.items()}
            elif opcode == ATTACHMENT:
                content = stream.read(length)
                if _is_whole(content):
                    attachment = _parsed(file, records.Attachment, content)
                    attachments[attachment.name] = attachment.data
                else:
                    damaged.append(_name(content))
            elif channels.codec is None or length < _SHORT_CHUNK:  # a remark has a chunk of its own
                at = stream.tell()
                inside = _inside(file, stream.read(length), sure=channels.codec is None)
                channels.take_in(inside)
                marks += map(json.loads, _messages(inside, channels.marks))
                if not inside or _messages(inside, channels.rows):
                    chunks.append((at, length))
            else:  # long enough to have rows: looked into when it is read
                chunks.append((stream.tell(), length))
    codec = channels.codec
    if codec is None or not about:
        raise CheckFailed(
            f"{file}: an MCAP file of another program, without the topic {header.BLOCKS_TOPIC}; "
            "export its messages as CSV or Parquet"
        )
    if about.get("format") != header.FORMAT:
        raise CheckFailed(f"{file}: its format is {about.get('format')!r}; this version reads format {header.FORMAT}")

    def blocks(decode: Callable[[bytes], T]) -> Iterator[T]:
        for at, length in chunks:
            yield from _decoded(file, at, length, channels.rows, decode)

    def arrays(beginning: str) -> list[NDArray[Any]]:
        return [_array(file, *each) for each in attachments.items() if each[0].startswith(beginning)]

    try:
        return Telemetry(
            file,
            axes=json.loads(about["axes"]),
            period_ns=int(about["period_ns"]),
            dtype=codec.dtype,
            configuration=attachments.get(header.CONFIGURATION, b"").decode(),
            sha256=about["sha256"],
            end=end,
            parts=lambda paths: blocks(partial(codec.decode, paths=paths)),
            rows=lambda: blocks(codec.rows),
            pieces=lambda: [partial(_piece, file, codec, channels.rows, *chunk) for chunk in chunks],
            state=next(iter(arrays(header.STATE)), None),
            parameters=arrays(header.PARAMETERS),
            states=arrays(header.STATES),
            marks=marks,
            samples=next(iter(arrays(header.SAMPLES)), None),
            sources=about["sources"],
            damaged=damaged,
        )
    except (KeyError, ValueError) as problem:
        raise CheckFailed(f"{file}: {_WHY} ({problem})") from problem


class _Channels:
    """Numbers of the channels with rows and remarks, -1 before they are known, and the codec of the rows."""

    def __init__(self, file: Path) -> None:
        self.rows = self.marks = -1
        self.codec: BlockCodec | None = None
        self._file = file

    def take_in(self, found: Iterable[tuple[int, bytes]]) -> None:
        """Take note of what is declared in some records."""
        for opcode, content in found:
            if opcode == SCHEMA:
                schema = _parsed(self._file, records.Schema, content)
                if schema.encoding == header.BLOCKS_ENCODING:
                    self.codec = self._described(schema.data)
            elif opcode == CHANNEL:
                channel = _parsed(self._file, records.Channel, content)
                self.rows = channel.id if channel.topic == header.BLOCKS_TOPIC else self.rows
                self.marks = channel.id if channel.topic == header.MARKS_TOPIC else self.marks

    def _described(self, schema: bytes) -> BlockCodec:
        try:
            return BlockCodec.described(json.loads(schema))
        except (KeyError, TypeError, ValueError) as problem:
            raise CheckFailed(f"{self._file}: {_WHY} ({problem})") from problem


def _is_whole(attachment: bytes) -> bool:
    """By the checksum at its end, of all before; 0 where its writer made none."""
    told = int.from_bytes(attachment[-_CHECKSUM_BYTES:], "little")
    return told in (0, zlib.crc32(attachment[:-_CHECKSUM_BYTES]))


def _name(attachment: bytes) -> str:
    """Of a damaged one, as far as it can be read."""
    size, begins = int.from_bytes(attachment[16:20], "little"), 20
    return ascii(attachment[begins : begins + min(size, 40)].decode(errors="replace")).strip("'") or "an attachment"


def _array(file: Path, name: str, data: bytes) -> NDArray[Any]:
    """A .npy file, or the only array of a file that ``numpy.savez_compressed`` has made."""
    try:
        if data.startswith(_ZIP):
            with zipfile.ZipFile(io.BytesIO(data)) as packed:
                (entry,) = packed.infolist()
                data = packed.read(entry) if entry.file_size <= _MOST_UNPACKED else b""
        found: NDArray[Any] = np.load(io.BytesIO(data), allow_pickle=False)
    except (ValueError, OSError, EOFError, zipfile.BadZipFile, zlib.error, RuntimeError) as problem:
        # NumPy's words have all of a record in them
        raise CheckFailed(f"{file}: {_WHY} (its attachment {name} can't be read)") from problem
    return found


def _decoded(file: Path, at: int, length: int, channel: int, decode: Callable[[bytes], T]) -> list[T]:
    """The messages with blocks in a chunk."""
    with file.open("rb") as stream:
        stream.seek(at)
        chunk = stream.read(length)
    try:
        return [decode(data) for data in _messages(_inside(file, chunk), channel)]
    except ValueError as problem:
        raise CheckFailed(f"{file}: {_WHY} ({problem})") from problem


def _piece(
    file: Path, codec: BlockCodec, channel: int, at: int, length: int, paths: Sequence[str]
) -> dict[str, NDArray[Any]]:
    blocks = _decoded(file, at, length, channel, partial(codec.decode, paths=paths))
    none = [np.empty(0, np.int64)] if not blocks else []  # another program puts chunks without rows between ours
    return {path: np.concatenate(none or [block[path] for block in blocks]) for path in paths}


def _inside(file: Path, chunk: bytes, *, sure: bool = True) -> list[tuple[int, bytes]]:
    """The records in a chunk, by its checksum; none of a damaged one that is not `sure` to be needed."""
    try:
        stream, length = get_chunk_data_stream(_parsed(file, records.Chunk, chunk), validate_crc=True)
        return list(records_in(stream.read(length)))
    except Exception as problem:  # whatever the decompressors raise
        if not sure:
            return []
        raise problem if isinstance(problem, CheckFailed) else CheckFailed(f"{file}: {_WHY} ({problem})") from problem


def _messages(inside: Iterable[tuple[int, bytes]], channel: int) -> list[bytes]:
    """What the messages on a channel hold."""
    return [
        content[_MESSAGE_HEAD.size :]
        for opcode, content in inside
        if opcode == MESSAGE and _MESSAGE_HEAD.unpack_from(content)[0] == channel
    ]


def _parsed(file: Path, kind: Any, content: bytes) -> Any:
    try:
        return kind.read(data_stream.ReadDataStream(io.BytesIO(content)))
    except (ValueError, struct.error, McapError) as problem:
        raise CheckFailed(f"{file}: {_WHY} ({problem})") from problem
