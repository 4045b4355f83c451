"""AL states asked for and waited for; a refusal in words."""

from __future__ import annotations

import struct
import time

from micromanip.driver import DeviceFault, LinkError
from micromanip.driver.ethercat import ERROR, STATE_MASK, STATE_NAMES, al_code_in_words, registers, state_name

from .link import Link

_PATIENCE_S = 3.0


def go(link: Link, station: int, name: str, state: int) -> None:
    """Bring a slave to a state that it can reach in one step; any error is acknowledged first.

    Raises DeviceFault where it refuses, LinkError where nothing happens.
    """
    acknowledge = status(link, station)[0] & ERROR
    link.station_write(station, registers.AL_CONTROL, struct.pack("<H", state | acknowledge))
    end = time.monotonic() + _PATIENCE_S
    while True:
        now, code = status(link, station)
        if now == state:
            return
        if now & ERROR and (code or now & STATE_MASK != state):
            raise DeviceFault(
                f"{link.name}: terminal {name} refuses {STATE_NAMES[state]} and is in {state_name(now)}: "
                f"{al_code_in_words(code)} (0x{code:04x})"
            )
        if time.monotonic() > end:
            raise LinkError(f"{link.name}: terminal {name} stays in {state_name(now)}, {STATE_NAMES[state]} was asked")


def status(link: Link, station: int) -> tuple[int, int]:
    """AL status and its code."""
    found = struct.unpack("<H2xH", link.station_read(station, registers.AL_STATUS, 6))
    return found[0] & (STATE_MASK | ERROR), found[1]
