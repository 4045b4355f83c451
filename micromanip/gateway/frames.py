"""Binary messages to the browser: a header of JSON, then arrays of 32-bit numbers, all little-endian.

length of the header (uint32) | header, padded with spaces to a multiple of 4 | the arrays it names, one after the other

`arrays` in the header is a list of [name, type, length]; types are `f4` and `u4`.
"""

from __future__ import annotations

import json
import struct
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

_LENGTH = struct.Struct("<I")
_TYPES = {"f": "f4", "u": "u4"}


def frame(header: Mapping[str, Any], arrays: Mapping[str, NDArray[Any]]) -> bytes:
    """One message; `arrays` are of float32 or uint32."""
    described = [[name, _TYPES[array.dtype.kind], len(array)] for name, array in arrays.items()]
    text = json.dumps({**header, "arrays": described}, separators=(",", ":"), allow_nan=False).encode()
    text += b" " * (-len(text) % 4)
    parts = [np.ascontiguousarray(array, f"<{array.dtype.kind}4").tobytes() for array in arrays.values()]
    return b"".join([_LENGTH.pack(len(text)), text, *parts])


def parsed(message: bytes) -> tuple[dict[str, Any], dict[str, NDArray[Any]]]:
    """Header and arrays of a message."""
    (length,) = _LENGTH.unpack_from(message)
    at = _LENGTH.size + length
    header: dict[str, Any] = json.loads(message[_LENGTH.size : at])
    arrays = {}
    for name, kind, count in header["arrays"]:
        arrays[name] = np.frombuffer(message, f"<{kind}", count, at)
        at += arrays[name].nbytes
    return header, arrays
