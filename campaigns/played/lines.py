"""Devices of lines: a GCS controller, an amplifier that takes `command,value`, a board with binary frames."""

import struct
import time

from fastcrc import crc16

from .amplifier import LATE_S, OUTPUTS

_SYNC, _SENSORS, _VOLTAGES = b"\xaa\x55", 0x10, 0x20
_PERIOD_S, _UM, _V = 0.01, 1e-4, 0.005
_RANGE_V = (-20.0, 120.0)


class _Lines:
    """Whole lines, one after the other."""

    def __init__(self, amplifier):
        self.amplifier, self._rest = amplifier, b""

    def hear(self, data):
        *lines, self._rest = (self._rest + data).split(self.end)
        for line in lines:
            yield from self.answer(line.decode("latin-1"))

    def say(self):
        return ()

    def spoilt(self, good, strange):
        """An answer with readings, or what goes wrong with it; `strange` is one for something else."""
        return {
            "empty": [(0.0, b"\n")],
            "silent": [],
            "garbage": [(0.0, b"\x80\xff?\x01\n")],
            "late": [(LATE_S, good)],
            "wrong unit": [(0.0, strange)],
        }.get(self.amplifier.fails, [(0.0, good)])


class Gcs(_Lines):
    """The General Command Set: ``SVA 1 12.3`` moves, ``POS? 1`` measures, ``ERR?`` tells the last error."""

    end = b"\n"
    _error = 0

    def answer(self, line):
        match line.split():
            case ["*IDN?"]:
                yield 0.0, b"(c)2020 Nobody Instruments, E-709, 117000001, 1.0\n"
            case ["ERR?"]:
                yield 0.0, b"%d\n" % self._error
                self._error = 0
            case ["POS?", *items]:
                yield from self._numbers(items, self.amplifier.strains_um())
            case ["SVA?", *items]:
                values = self.amplifier.registers()
                if values is None:
                    self._error = 2
                else:
                    yield from self._numbers(items, [values[name] for name in OUTPUTS])
            case ["SVA", item, number] if item in ("1", "2"):
                if not _RANGE_V[0] <= float(number) <= _RANGE_V[1]:
                    self._error = 17
                elif not self.amplifier.command({OUTPUTS[int(item) - 1]: float(number)}):
                    self._error = 5
            case _:
                self._error = 2

    def _numbers(self, items, values):
        if self.amplifier.fails == "exception":
            self._error = 10
            return
        words = ["nan" if self.amplifier.fails == "nan" else f"{values[int(item) - 1]:.4f}" for item in items]
        lines = [f"{item}={word}" for item, word in zip(items, words, strict=True)]
        yield from self.spoilt((" \n".join(lines) + "\n").encode(), b"9=1.0\n")


class CommandValue(_Lines):
    """``set,0,12.3`` moves, ``meas,0`` measures; what is not taken is answered by ``err,n``."""

    end = b"\r"

    def answer(self, line):
        match line.split(","):
            case ["set", item, number]:
                if not self.amplifier.command({OUTPUTS[int(item)]: float(number)}):
                    yield 0.0, b"err,4\r\n"
            case ["meas", item]:
                if self.amplifier.fails == "exception":
                    yield 0.0, b"err,7\r\n"
                    return
                value = self.amplifier.strains_um()[int(item)]
                word = "-----" if self.amplifier.fails == "nan" else f"{value:.4f}"
                yield from self.spoilt(f"meas,{item},{word}\r\n".encode(), b"meas,7,1.0\r\n")
            case _:
                yield 0.0, b"err,1\r\n"


class Board:
    """Sends readings 100 times a second in frames AA 55, length, kind, counter, ..., CRC; takes such with voltages."""

    def __init__(self, amplifier):
        self.amplifier, self._rest = amplifier, b""
        self._count, self._due_s = 0, time.monotonic()

    def hear(self, data):
        self._rest += data
        while (at := self._rest.find(_SYNC)) >= 0 and len(self._rest) >= at + 3:
            end = at + self._rest[at + 2] + 6
            if len(self._rest) < end:
                break
            frame = self._rest[at:end]
            good = crc16.ibm_3740(frame[2:-2]) == int.from_bytes(frame[-2:], "big")
            self._rest = self._rest[end if good else at + len(_SYNC) :]
            if good and frame[3] == _VOLTAGES:
                counts = struct.unpack_from("<hh", frame, 6)
                self.amplifier.command({name: _V * count for name, count in zip(OUTPUTS, counts, strict=True)})
        return ()

    def say(self):
        if time.monotonic() < self._due_s:
            return
        self._due_s = max(self._due_s + _PERIOD_S, time.monotonic() - _PERIOD_S)
        fails = self.amplifier.fails
        if fails == "silent":
            return
        if fails not in ("stale", "late"):
            self._count = (self._count + 1) % 65536
        numbers = [round(value / _UM) for value in self.amplifier.strains_um()]
        if fails in ("nan", "exception"):
            numbers = [-(2**31), -(2**31)]
        kind = 0x33 if fails == "wrong unit" else _SENSORS
        body = b"" if fails == "empty" else struct.pack("<Hii", self._count, *numbers)
        frame = bytes((len(body), kind)) + body
        crc = crc16.ibm_3740(frame) ^ (0x5A5A if fails == "garbage" else 0)
        yield _SYNC + frame + crc.to_bytes(2, "big")
