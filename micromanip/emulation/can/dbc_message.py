"""A message of a DBC file from the device's side, encoded and decoded by cantools."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from micromanip.testbus.frame import Frame


class DbcMessage:
    """Values to frames and back, for one message of cantools."""

    def __init__(self, message: Any, *, counter: str | None) -> None:
        """`counter` is the signal that counts the frames."""
        self.name: str = message.name
        self.identifier: int = message.frame_id
        self.extended: bool = message.is_extended_frame
        self.signals: list[str] = [signal.name for signal in message.signals if signal.name != counter]
        self._message, self._counter = message, counter
        self._fd = bool(message.is_fd)
        self._bitrate_switch = self._fd and _switches_bitrate(message)
        self._ends = {signal.name: _ends(signal) for signal in message.signals}
        self._counts = max((1 << signal.length for signal in message.signals if signal.name == counter), default=0)

    def frame(self, values: Mapping[str, float], count: int) -> Frame:
        """A frame; a value that its signal can't hold is the nearest one that it can.

        NaN is sent as such where the DBC has a floating-point number, else as the largest code.
        """
        held: dict[str, float] = {}
        for name, value in values.items():
            low, high, floating = self._ends[name]
            if math.isnan(value):
                held[name] = value if floating else high
            else:
                held[name] = min(max(value, low), high)
        if self._counter is not None:
            held[self._counter] = count % self._counts
        data: bytes = self._message.encode(held, strict=False)
        return Frame(self.identifier, data, self.extended, self._fd, self._bitrate_switch)

    def values(self, frame: Frame) -> dict[str, float] | None:
        """Values by signal, without the counter; None for a frame that is too short."""
        if len(frame.data) < self._message.length:
            return None
        values: dict[str, float] = self._message.decode(frame.data, decode_choices=False)
        values.pop(self._counter or "", None)
        return values


def _ends(signal: Any) -> tuple[float, float, bool]:
    """Lowest and highest value that the bits of a signal hold, and whether it is a floating-point number."""
    if signal.is_float:
        return -math.inf, math.inf, True
    bits = signal.length
    codes = (-(1 << bits - 1), (1 << bits - 1) - 1) if signal.is_signed else (0, (1 << bits) - 1)
    ends = sorted(code * signal.scale + signal.offset for code in codes)
    return ends[0], ends[1], False


def _switches_bitrate(message: Any) -> bool:
    """Whether the data of a CAN FD message go at the second rate: as its attribute CANFD_BRS says, else they do."""
    attribute = message.dbc.attributes.get("CANFD_BRS") if message.dbc else None
    return attribute is None or bool(int(attribute.value))
