"""Where records stand in an MCAP file: by the index at its end, or one after another from its beginning.

A file whose writer was killed has no index; where it ends within a record, it ends before it.
"""

from __future__ import annotations

import os
import struct
from collections.abc import Iterator
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
