"""Who speaks on a bus, for `device probe`: it listens, and never sends."""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import can

from micromanip.driver import Answer

from .database import is_multiplexed, nonsense
from .link import CanLink
from .plan import UnpackPlan, bit_field


@dataclass
class _Speaker:
    frames: int
    newest: can.Message


def sniff(link: CanLink, messages: Mapping[tuple[int, bool], Any], seconds: float) -> Iterator[Answer]:
    """Each identifier that was heard in so many seconds, lowest first. Raises LinkError.

    `messages` are those of cantools, by (identifier, extended).
    """
    speakers: dict[tuple[int, bool], _Speaker] = {}
    link.open_fully()
    try:
        end_ns = time.monotonic_ns() + round(seconds * 1e9)
        while time.monotonic_ns() < end_ns:
            for message, _ in link.receive(end_ns):
                key = (message.arbitration_id, message.is_extended_id)
                speaker = speakers.setdefault(key, _Speaker(0, message))
                speaker.frames, speaker.newest = speaker.frames + 1, message
    finally:
        link.close()
    for key in sorted(speakers, key=lambda key: (key[1], key[0])):
        yield _answer(key, speakers[key], messages.get(key), seconds)


def _answer(key: tuple[int, bool], speaker: _Speaker, known: Any, seconds: float) -> Answer:
    data = bytes(speaker.newest.data)
    values: dict[str, Any] = {
        "rate_hz": round(speaker.frames / seconds, 1),
        "bytes": len(data),
        "fd": speaker.newest.is_fd,
        "data": data.hex(" "),
    }
    name = f"message {key[0]:#05x}" if not key[1] else f"message {key[0]:#010x} (extended)"
    if known is None:
        return Answer(name, values, "not in the database", is_value=False)
    if is_multiplexed(known) or len(data) < known.length:
        why = "multiplexed" if is_multiplexed(known) else f"{known.length} bytes in the database"
        return Answer(name, values, f"{known.name}, signals not shown: {why}", is_value=len(data) >= known.length)
    if (found := nonsense(known)) is not None:
        return Answer(name, values, f"{known.name}, signals not shown: {found}", is_value=False)
    fields = [bit_field(signal, known.length) for signal in known.signals]
    numbers = UnpackPlan(fields).values(data[: known.length])
    values |= {field.name: number for field, number in zip(fields, numbers, strict=True)}
    return Answer(name, values, known.name)
