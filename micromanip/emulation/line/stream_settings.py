"""The device's side of the framing `stream`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from micromanip.emulation.plain_options import Place, section, value
from micromanip.settings.text.source import Source

from .binary_settings import hexadecimal
from .checksum import read_checksum
from .number import read_number, read_optional
from .stream_device import PacketLayout

_PACKETS_PER_S = 1000
"""As many as a device sends at most where it may choose how many samples go into one."""


def read_packet(source: Source, place: Place, options: Mapping[str, Any]) -> PacketLayout:
    """The layout that the section `stream` at `place` describes; raises ConfigError with file, line and key."""
    counter, status, time = (options.get(key) for key in ("counter", "status", "time"))
    blocks = options.get("blocks")
    time_number = read_optional(source, place, options, "time")
    if time_number is not None and time is not None:
        time_number = replace(time_number, scale=float(value(source, (*place, "time"), time, "unit_s", (int, float))))
    identity = {
        name: (
            read_number(source, (*place, "identity", name), entry),
            float(value(source, (*place, "identity", name), entry, "value", int)),
        )
        for name, entry in section(source, place, options, "identity").items()
    }
    return PacketLayout(
        magic=hexadecimal(source, place, options, "magic"),
        header_bytes=value(source, place, options, "header_bytes", int),
        block_bytes=value(source, place, options, "block_bytes", int),
        blocks=read_optional(source, place, options, "blocks") if isinstance(blocks, Mapping) else None,
        counter=read_optional(source, place, options, "counter"),
        counts_samples=isinstance(counter, Mapping) and counter.get("counts") == "samples",
        time=time_number,
        status=read_optional(source, place, options, "status"),
        good_status=int((status or {}).get("good", (0,))[0]),
        identity=identity,
        fields={
            name: read_number(source, (*place, "fields", name), entry)
            for name, entry in section(source, place, options, "fields").items()
        },
        checksum=read_checksum(source, (*place, "crc"), options.get("crc")),
    )


def samples_a_packet(source: Source, place: Place, options: Mapping[str, Any]) -> int:
    """As configured; where the header tells it, so many that there are at most 1000 packets a second."""
    blocks = options.get("blocks", 1)
    if not isinstance(blocks, Mapping):
        return int(value(source, place, {"blocks": blocks}, "blocks", int))
    most = value(source, (*place, "blocks"), blocks, "most", int)
    rate_hz = value(source, place, options, "rate_hz", (int, float))
    return int(min(most, max(1, round(rate_hz / _PACKETS_PER_S))))
