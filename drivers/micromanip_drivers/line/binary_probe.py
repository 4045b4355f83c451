"""Which frames come on a line, for `device probe`."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from dataclasses import replace

from micromanip.driver import Answer

from .binary_messages import FrameKinds
from .frame_reader import FrameReader
from .port import Port

_AGAIN_NS = 50_000_000


def found(
    port: Port, reader: FrameReader, kinds: FrameKinds, asking: Sequence[bytes], seconds: float
) -> Iterator[Answer]:
    """The newest frame of each kind, for so many seconds; `asking` are frames that move nothing, sent in turns."""
    before, begin_ns = reader.received, time.monotonic_ns()
    end_ns = begin_ns + round(seconds * 1e9)
    seen: dict[str, int] = {}
    turn = 0
    while (now_ns := time.monotonic_ns()) < end_ns:
        if asking:
            port.send(asking[turn % len(asking)])
            turn += 1
        until_ns = min(end_ns, now_ns + _AGAIN_NS)
        while time.monotonic_ns() < until_ns:
            for frame, time_ns in reader.frames(until_ns):
                answer = _answer(kinds, frame)
                seen[answer.name] = seen.get(answer.name, 0) + 1
                rate_hz = round(seen[answer.name] / max(1e-3, (time_ns - begin_ns) * 1e-9), 1)
                yield replace(answer, values={"frames_per_s": rate_hz, **answer.values})
            reader.pardon()
    if not seen and reader.received > before:
        unheard = reader.unheard(before, "sends nothing")
        yield Answer(port.name, {"bytes": reader.received - before}, unheard, is_value=False)


def _answer(kinds: FrameKinds, frame: bytes) -> Answer:
    message, identity, kind = kinds.message(frame), kinds.identity, kinds.kind(frame)
    values: dict[str, object] = {} if kind is None else {"kind": f"{kind:#04x}"}
    values["data"] = frame.hex(" ")
    note = ""
    if identity is not None and kind == identity.kind:
        note = " and ".join(identity.mismatches(frame)) or "the device of the configuration"
        values |= identity.values(frame)
    if message is not None:
        return Answer(message.name, {**values, "status": message.status(frame), **message.values(frame)}, note)
    if note:
        return Answer("identity", values, note)
    return Answer(f"frame of kind {kind}", values, "not in the configuration", is_value=False)
