"""A gauge (unit 3) and an amplifier (unit 7) behind one Modbus port, TCP or RTU; readings of the gauge go wrong."""

import struct

from fastcrc import crc16

from .amplifier import LATE_S, OUTPUTS

GAUGE, AMPLIFIER = 3, 7
_FIRST, _UM, _V = 100, 1e-4, 0.005
_ADDRESS, _FAILED, _BUSY = 2, 4, 6


class _Units:
    def __init__(self, amplifier):
        self.amplifier, self._rest = amplifier, b""

    def say(self):
        return ()

    def answered(self, unit, request):
        """The answers to a PDO, each (late by s, unit, PDU)."""
        function = request[0]
        if unit == GAUGE and function == 3:
            numbers = [round(value / _UM) for value in self.amplifier.strains_um()]
            if self.amplifier.fails == "nan":
                numbers = [-(2**31), -(2**31)]
            first, count = struct.unpack_from(">HH", request, 1)
            data = struct.pack(">ii", *numbers)[2 * first : 2 * (first + count)]
            good = bytes((3, len(data))) + data
            return {
                "empty": [(0.0, unit, b"\x03\x00")],
                "silent": [],
                "exception": [(0.0, unit, bytes((0x83, _FAILED)))],
                "garbage": [(0.0, unit, b"\x55" + good[1:])],
                "late": [(LATE_S, unit, good)],
                "wrong unit": [(0.0, 9, good)],
            }.get(self.amplifier.fails, [(0.0, unit, good)])
        if unit != AMPLIFIER:
            return []
        return [(0.0, unit, self._amplifier(function, request) or bytes((function | 0x80, _ADDRESS)))]

    def _amplifier(self, function, request):
        first, count = struct.unpack_from(">HH", request, 1)
        if function == 3 and (values := self.amplifier.registers()) is not None:
            counts = [round(values[name] / _V) for name in OUTPUTS][first - _FIRST : first - _FIRST + count]
            return struct.pack(f">BB{len(counts)}h", 3, 2 * len(counts), *counts) if counts else None
        if function == 16 and first >= _FIRST:
            counts = struct.unpack_from(f">{count}h", request, 6)
            names = OUTPUTS[first - _FIRST :]
            volts = {name: _V * number for name, number in zip(names, counts, strict=False)}
            return request[:5] if self.amplifier.command(volts) else bytes((0x90, _BUSY))
        return None


class TcpUnits(_Units):
    """With a header of transaction number, length and unit."""

    def hear(self, data):
        self._rest += data
        while len(self._rest) >= 6 and len(self._rest) >= (end := 6 + int.from_bytes(self._rest[4:6], "big")):
            frame, self._rest = self._rest[:end], self._rest[end:]
            for late_s, unit, pdu in self.answered(frame[6], frame[7:]):
                yield late_s, frame[:4] + struct.pack(">HB", len(pdu) + 1, unit) + pdu


class RtuUnits(_Units):
    """With a CRC; a frame's end is known by its function."""

    def hear(self, data):
        self._rest += data
        while len(self._rest) >= 8:
            length = 9 + self._rest[6] if self._rest[1] == 16 else 8
            if len(self._rest) < length:
                return
            if crc16.modbus(self._rest[: length - 2]) != int.from_bytes(self._rest[length - 2 : length], "little"):
                self._rest = self._rest[1:]
                continue
            frame, self._rest = self._rest[:length], self._rest[length:]
            for late_s, unit, pdu in self.answered(frame[0], frame[1:-2]):
                answer = bytes((unit,)) + pdu
                yield late_s, answer + crc16.modbus(answer).to_bytes(2, "little")
