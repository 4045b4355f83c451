"""A device that answers each datagram with voltages by one with readings."""

import struct
import zlib

from .amplifier import LATE_S, OUTPUTS

_ANSWER, _COMMAND = struct.Struct("<2sHHBii"), struct.Struct("<2sHii")
_UM, _V = 1e-4, 1e-4
_GOOD, _BAD = 0, 1


def _sealed(data):
    return data + struct.pack("<I", zlib.crc32(data))


class Datagrams:
    """Its counter begins anew with its power."""

    def __init__(self, amplifier):
        self.amplifier, self._count, self._acted = amplifier, 0, 65535

    def say(self):
        return ()

    def hear(self, data):
        if len(data) != _COMMAND.size + 4 or data != _sealed(data[:-4]):
            return
        _, count, *numbers = _COMMAND.unpack(data[:-4])
        if self.amplifier.command({name: _V * number for name, number in zip(OUTPUTS, numbers, strict=True)}):
            self._acted = count
        fails = self.amplifier.fails
        if fails != "stale":
            self._count = (self._count + 1) % 65536
        head = b"\xa5\x33" if fails == "wrong unit" else b"\xa5\x10"
        codes = [round(value / _UM) for value in self.amplifier.strains_um()]
        status = _BAD if fails in ("nan", "exception") else _GOOD
        answer = _sealed(_ANSWER.pack(head, self._count, self._acted, status, *codes))
        if fails == "garbage":
            answer = bytes(byte ^ 0x55 for byte in answer)
        if fails != "silent":
            yield LATE_S if fails == "late" else 0.0, b"" if fails == "empty" else answer
