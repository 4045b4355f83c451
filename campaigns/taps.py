"""A tap listens to one connection, and reads the voltages out of the bytes of its protocol.

None of the product's code is used: a tap has its own idea of the protocol, and of the cell's layout.
"""

import math
import struct
import threading
import time
from dataclasses import dataclass

from fastcrc import crc16

SYNC, VOLTAGES = b"\xaa\x55", 0x20


@dataclass(eq=False)
class Arrival:
    """One output's value on its way into the device."""

    time_ns: int
    name: str
    volts: float
    taken_ns: int | None = None
    """When the device said that it has done it; None where it has not, or never says so."""
    refused: bool = False


class Arrivals:
    """Each value that arrived at the device since the last `forget`, in order; written by the wire's thread."""

    def __init__(self):
        self._lock = threading.Lock()
        self._all = []
        self.count = 0

    def add(self, name, volts):
        """One more, now."""
        return self.take_up(Arrival(time.monotonic_ns(), name, volts))

    def take_up(self, arrival):
        """One more, with its own time."""
        with self._lock:
            self._all.append(arrival)
            self.count += 1
        return arrival

    def copy(self):
        """In the order of arrival."""
        with self._lock:
            return list(self._all)

    def forget(self, before_ns):
        """Keep only what is newer, and the last of each output that was not refused."""
        with self._lock:
            last = {each.name: each for each in self._all if each.time_ns < before_ns and not each.refused}
            old = sorted(last.values(), key=lambda each: each.time_ns)
            self._all = old + [each for each in self._all if each.time_ns >= before_ns]

    def volts(self):
        """Each output's newest value that was not refused."""
        return {each.name: each.volts for each in self.copy() if not each.refused}


class GcsTap:
    """Reads one connection to a GCS controller: ``SVA 1 12.3`` moves, the answer to ``ERR?`` says whether it did."""

    def __init__(self, arrivals, outputs):
        """`outputs` are by the controller's names of its axes."""
        self._arrivals, self._outputs = arrivals, outputs
        self._to, self._from = b"", b""
        self._unanswered, self._asked = [], []

    def to_device(self, data):
        """What may go on to the device of what came: whole lines."""
        *lines, self._to = (self._to + data).split(b"\n")
        for line in lines:
            self._hear(line.decode("latin-1").split())
        return b"".join(line + b"\n" for line in lines)

    def _hear(self, words):
        match words:
            case ["ERR?"]:
                self._asked.append(self._unanswered)
                self._unanswered = []
            case ["SVA", *pairs]:
                for item, number in zip(pairs[::2], pairs[1::2], strict=False):
                    if item in self._outputs:
                        self._unanswered.append(self._arrivals.add(self._outputs[item], number_of(number)))

    def from_device(self, data):
        """Listen to the answers."""
        *lines, self._from = (self._from + data).split(b"\n")
        for line in lines:
            if line.strip().isdigit() and self._asked:
                settle(self._asked.pop(0), refused=int(line) != 0)


class ModbusTap:
    """Reads one connection to a Modbus TCP device: functions 6, 16 and 23 write registers, an exception refuses."""

    def __init__(self, arrivals, registers):
        """`registers` (int16) are by their addresses: (output, V a count)."""
        self._arrivals, self._registers = arrivals, registers
        self._to, self._from = b"", b""
        self._unanswered = {}

    def to_device(self, data):
        """What may go on to the device of what came: whole frames."""
        frames, self._to = _modbus_frames(self._to + data)
        for frame in frames:
            number, pdu = frame[:2], frame[7:]
            self._unanswered[number] = [self._arrivals.add(name, volts) for name, volts in self._written(pdu)]
        return b"".join(frames)

    def _written(self, pdu):
        if pdu[0] == 6:
            (first,), data = struct.unpack(">H", pdu[1:3]), pdu[3:5]
        elif pdu[0] == 16:
            (first,), data = struct.unpack(">H", pdu[1:3]), pdu[6:]
        elif pdu[0] == 23:
            (first,), data = struct.unpack(">H", pdu[5:7]), pdu[10:]
        else:
            return
        for place, (count,) in enumerate(struct.iter_unpack(">h", data)):
            if first + place in self._registers:
                name, scale = self._registers[first + place]
                yield name, scale * count

    def from_device(self, data):
        """Listen to the answers."""
        frames, self._from = _modbus_frames(self._from + data)
        for frame in frames:
            settle(self._unanswered.pop(frame[:2], ()), refused=frame[7] >= 0x80)


class BoardTap:
    """Reads one opening of a serial board: frames AA 55, length, kind, ..., CRC; of kind 20 are the voltages."""

    def __init__(self, arrivals, fields):
        """`fields` (int16, little) are by their places in the frame: (output, V a count)."""
        self._arrivals, self._fields = arrivals, fields
        self._to = b""

    def to_device(self, data):
        """What may go on to the device of what came: whole frames, and what is none."""
        self._to += data
        passed = b""
        while (at := self._to.find(SYNC)) >= 0 and len(self._to) >= at + 3:
            end = at + self._to[at + 2] + 6
            if len(self._to) < end:
                break
            frame = self._to[at:end]
            if crc16.ibm_3740(frame[2:-2]) == int.from_bytes(frame[-2:], "big"):
                self._hear(frame)
            else:  # not a frame: the next one may begin behind these
                end = at + len(SYNC)
            passed, self._to = passed + self._to[:end], self._to[end:]
        return passed

    def _hear(self, frame):
        if frame[3] == VOLTAGES:
            for place, (name, scale) in self._fields.items():
                (count,) = struct.unpack_from("<h", frame, place)
                self._arrivals.add(name, scale * count)

    def from_device(self, data):
        """It acknowledges nothing."""


def _modbus_frames(data):
    """Whole frames, and the rest."""
    frames = []
    while len(data) >= 6 and len(data) >= (end := 6 + int.from_bytes(data[4:6], "big")):
        frames.append(data[:end])
        data = data[end:]
    return frames, data


def settle(arrivals, *, refused):
    """The device has said what became of some values."""
    for arrival in arrivals:
        arrival.taken_ns, arrival.refused = time.monotonic_ns(), refused


def number_of(text):
    """What is no number is not finite either."""
    try:
        return float(text)
    except ValueError:
        return math.nan
