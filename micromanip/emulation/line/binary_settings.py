"""The device's side of the framing `binary`: what the driver receives the board sends, and the other way round."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from micromanip.emulation.plain_options import Place, near, section, value
from micromanip.settings.text.source import Source

from .binary_board import BoardIdentity, BoardMessages
from .binary_frame import FrameFormat, FrameLayout
from .checksum import read_checksum
from .number import LineNumber, read_number, read_optional


def read_board(source: Source, place: Place, options: Mapping[str, Any]) -> BoardMessages:
    """All messages of the section `binary` at `place`; raises ConfigError with file, line and key."""
    length = options.get("length")
    frame_format = FrameFormat(
        sync=hexadecimal(source, place, options, "sync"),
        length=read_optional(source, place, options, "length"),
        length_plus=int(length.get("plus", 0)) if isinstance(length, Mapping) else 0,
        kind=read_optional(source, place, options, "kind"),
        checksum=read_checksum(source, (*place, "crc"), options.get("crc")),
    )
    receive, send = (section(source, place, options, key) for key in ("receive", "send"))
    sent = {
        name: _layout(source, (*place, "receive", name), name, entry, frame_format) for name, entry in receive.items()
    }
    replies = {entry.get("reply") for entry in send.values()} - {None}
    for name in replies - sent.keys():
        raise source.error((*place, "send"), f"there is no message {name} that could answer; {near(name, sent)}")
    received = [
        (_layout(source, (*place, "send", name), name, entry, frame_format), sent.get(entry.get("reply")))
        for name, entry in send.items()
    ]
    periodic = [
        (layout, period_ns(source, (*place, "receive", name), receive[name]))
        for name, layout in sent.items()
        if name not in replies
    ]
    identity = _identity(source, place, options, frame_format)
    turnaround_ns = round(float(options.get("turnaround_us", 0.0)) * 1e3)
    return BoardMessages(frame_format, periodic, received, identity, turnaround_ns)


def period_ns(source: Source, place: Place, entry: Any) -> int:
    """Of a message with a ``rate_hz``."""
    rate_hz = float(value(source, place, entry, "rate_hz", (int, float)))
    if not rate_hz > 0:
        raise source.error((*place, "rate_hz"), f"must be greater than 0, not {rate_hz:g}")
    return round(1e9 / rate_hz)


def hexadecimal(source: Source, place: Place, entry: Any, key: str) -> bytes:
    """Bytes that are written as digits, blanks between them or not."""
    text = value(source, place, entry, key, str)
    try:
        return bytes.fromhex(text)
    except ValueError:
        raise source.error((*place, key), f'"{text}" is not hexadecimal') from None


def _layout(source: Source, place: Place, name: str, entry: Any, frame_format: FrameFormat) -> FrameLayout:
    fields = {
        field: read_number(source, (*place, "fields", field), number)
        for field, number in section(source, place, entry, "fields").items()
    }
    counter, status = (read_optional(source, place, entry, key) for key in ("counter", "status"))
    parts = [*fields.values(), *(part for part in (counter, status) if part is not None)]
    good = (entry.get("status") or {}).get("good", (0,))
    size = entry.get("bytes") or frame_format.size_at_end_of(parts)
    return FrameLayout(name, entry.get("kind"), int(size), counter, status, int(good[0]), fields)


def _identity(
    source: Source, place: Place, options: Mapping[str, Any], frame_format: FrameFormat
) -> BoardIdentity | None:
    entry = options.get("identity")
    if entry is None:
        return None
    place = (*place, "identity")
    numbers = section(source, place, entry, "numbers")
    fields: dict[str, LineNumber] = {
        name: read_number(source, (*place, "numbers", name), number) for name, number in numbers.items()
    }
    values = {
        name: float(value(source, (*place, "numbers", name), number, "value", int)) for name, number in numbers.items()
    }
    size = entry.get("bytes") or frame_format.size_at_end_of(list(fields.values()))
    layout = FrameLayout("identity", entry.get("kind"), int(size), None, None, 0, fields)
    request = None
    if entry.get("request"):
        request = hexadecimal(source, place, entry, "request")
        request += frame_format.checksum.of(request) if frame_format.checksum else b""
    return BoardIdentity(request, layout, values)
