"""Where records stand in an MCAP file: by the index at its end, or one after another from its beginning.

A file whose writer was killed has no index; where it ends within a record, it ends before it.
"""

from __future__ import annotations

import os
import struct
from collections.abc import Iterator
from pathlib import Path
from typing import IO

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


def whole_records(file: Path) -> Iterator[tuple[int, bytes]]:
    """Metadata, attachments and chunks that are there as a whole, up to the index."""
    with file.open("rb") as stream:
        for opcode, length in places(stream):
            yield opcode, stream.read(length)


def places(stream: IO[bytes]) -> Iterator[tuple[int, int]]:
    """Kind and length of the same; `stream` stands at the beginning of each, and may be left anywhere."""
    size = os.fstat(stream.fileno()).st_size
    if index := _index(stream, size):
        for at, opcode, length in index:
            stream.seek(at)
            yield opcode, length
        return
    at = len(MAGIC)
    while at + RECORD.size <= size:
        stream.seek(at)
        opcode, length = RECORD.unpack(stream.read(RECORD.size))
        at += RECORD.size + length
        if opcode == _DATA_END or at > size:
            return
        if opcode in (METADATA, ATTACHMENT, CHUNK):
            yield opcode, length


def begins_without_chunks(file: Path) -> bool:
    """Whether a channel comes before any chunk."""
    with file.open("rb") as stream:
        stream.seek(len(MAGIC))
        while len(head := stream.read(RECORD.size)) == RECORD.size:
            opcode, length = RECORD.unpack(head)
            if opcode in (CHUNK, CHANNEL, _DATA_END):
                return bool(opcode == CHANNEL)
            stream.seek(length, os.SEEK_CUR)
    return False


def declared(stream: IO[bytes]) -> list[tuple[int, bytes]]:
    """Schemas and channels as they stand beside the index once more: where the chunk that has them is damaged."""
    size = os.fstat(stream.fileno()).st_size
    return [each for each in _summary(stream, size) if each[0] in (SCHEMA, CHANNEL)] if _index(stream, size) else []


def _index(stream: IO[bytes], size: int) -> list[tuple[int, int, int]]:
    """Place, kind and length of the same, by the index at the end of a file that was ended in order; else nothing."""
    found = []
    for opcode, content in _summary(stream, size):
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


def _summary(stream: IO[bytes], size: int) -> Iterator[tuple[int, bytes]]:
    """Kind and content of what stands at the end of a file that was ended in order; else nothing."""
    if size < len(MAGIC) + _FOOTER.size:
        return
    stream.seek(size - _FOOTER.size)
    opcode, _, start, _, _, magic = _FOOTER.unpack(stream.read(_FOOTER.size))
    if opcode != _FOOTER_RECORD or magic != MAGIC or not 0 < start < size:
        return
    stream.seek(start)
    summary, at = stream.read(size - _FOOTER.size - start), 0
    while at + RECORD.size <= len(summary):
        opcode, length = RECORD.unpack_from(summary, at)
        at += RECORD.size
        if at + length <= len(summary):
            yield opcode, summary[at : at + length]
        at += length
