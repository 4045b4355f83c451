"""A recording that its writer left open: marked as closed, so that every HDF5 reader takes it.

HDF5 marks a file as open for writing in its superblock (version 3), and only who closes it in order takes the
mark away. What ``h5clear -s`` does, without a package of tools.
"""

from __future__ import annotations

import os
import struct
from pathlib import Path

_SIGNATURE = b"\x89HDF\r\n\x1a\n"
_SIZE, _VERSION, _OFFSET_BYTES, _MARK, _END, _SUM = 48, 8, 9, 11, 28, 44
"""Bytes of the superblock, and where in it stand: version, size of offsets, the mark, end of the file, checksum."""
_WORD = 0xFFFFFFFF


def close_unclosed(file: Path) -> bool:
    """Mark `file` as closed; False where it is no HDF5 file of that kind. Raises OSError."""
    with file.open("r+b") as stream:
        block = bytearray(stream.read(_SIZE))
        if len(block) < _SIZE or not block.startswith(_SIGNATURE) or block[_VERSION : _OFFSET_BYTES + 1] != b"\3\x08":
            return False
        if struct.unpack_from("<I", block, _SUM) != (checksum(bytes(block[:_SUM])),):
            return False
        block[_MARK] = 0
        struct.pack_into("<Q", block, _END, os.fstat(stream.fileno()).st_size)
        struct.pack_into("<I", block, _SUM, checksum(bytes(block[:_SUM])))
        stream.seek(0)
        stream.write(block)
    return True


def checksum(data: bytes) -> int:
    """Bob Jenkins' lookup3, with which HDF5 guards its metadata."""
    a = b = c = (0xDEADBEEF + len(data)) & _WORD
    for start in range(0, len(data), 12):
        x, y, z = struct.unpack("<III", data[start : start + 12].ljust(12, b"\0"))
        a, b, c = (a + x) & _WORD, (b + y) & _WORD, (c + z) & _WORD
        if start + 12 < len(data):
            a, b, c = _mixed(a, b, c)
    c = ((c ^ b) - _turned(b, 14)) & _WORD
    a = ((a ^ c) - _turned(c, 11)) & _WORD
    b = ((b ^ a) - _turned(a, 25)) & _WORD
    c = ((c ^ b) - _turned(b, 16)) & _WORD
    a = ((a ^ c) - _turned(c, 4)) & _WORD
    b = ((b ^ a) - _turned(a, 14)) & _WORD
    return ((c ^ b) - _turned(b, 24)) & _WORD


def _mixed(a: int, b: int, c: int) -> tuple[int, int, int]:
    for bits in (4, 6, 8, 16, 19, 4):
        a = ((a - c) & _WORD) ^ _turned(c, bits)
        a, b, c = b, (c + b) & _WORD, a
    return a, b, c


def _turned(value: int, bits: int) -> int:
    return (value << bits | value >> 32 - bits) & _WORD
