"""The faults of EtherCAT that the campaign tries: on a line of three terminals, on a ring, and with a drive."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from .cases import CUT_OFF, LINK, STRAIN, Case, inject, tell

_LOST, _NOT_OK = (LINK,), ("X-111",)


def cut(*places: int) -> Callable[[Any], None]:
    """The cable, behind so many terminals each."""
    return lambda bench: [bench.device.order(inject="cut", behind=place, for_s=0.6) for place in places] and None


_WITHOUT_POWER = Case(
    "a terminal without power for 0.6 s",
    inject("power", terminal="gauge"),
    CUT_OFF,
    200.0,
    ("bring_ups",),
    lasts_s=3.0,
)
_FRAMES = (
    Case("1 % of the frames lost", inject("drop", share=0.01), counted=("lost",)),
    Case("30 % of the frames doubled", inject("duplicate", share=0.3), counted=("doubled",)),
    Case("10 % of the frames overtaken", inject("reorder", share=0.1), counted=("late",)),
    Case("all frames 3 ms late", inject("delay", ms=3.0)),
    Case("all frames lost", inject("drop"), CUT_OFF, 200.0),
    Case("interface gone", inject("unplug"), CUT_OFF, 200.0),
)

_LEFT_OP = Case(
    "a terminal falls back to SAFEOP, 0x001d",
    inject("left_op", for_s=None, terminal="amplifier", code=0x1D),
    _LOST,
    50.0,
    ("not_operating", "bring_ups"),
    lasts_s=1.5,
)
_MAILBOX = Case(
    "mailbox silent", inject("mailbox", for_s=None, terminal="amplifier"), note="it is asked before operation only"
)

LINE = (
    *_FRAMES,
    Case(
        "a terminal takes no part: wrong working counter",
        inject("absent", terminal="gauge"),
        CUT_OFF,
        200.0,
        ("wrong_working_counter",),
    ),
    _LEFT_OP,
    _WITHOUT_POWER,
    Case(
        "two terminals change places for 1.5 s",
        inject("order", terminal="gauge", for_s=1.5),
        CUT_OFF,
        200.0,
        ("bring_ups",),
        lasts_s=3.0,
        said="the order has changed",
    ),
    Case("cable cut behind the first terminal", cut(1), CUT_OFF, 200.0, ("wrong_working_counter",)),
    Case("the first clock drifts by 60 ppm", inject("clock", terminal="amplifier", ppm=60.0)),
    Case(
        "the first clock drifts by 900 ppm",
        inject("clock", terminal="amplifier", ppm=900.0, for_s=3.0),
        _LOST,
        2000.0,
        ("unlocked",),
        lasts_s=3.0,
    ),
    _MAILBOX,
    Case("gauge says NaN: the largest code", tell("nan", signal="strain_x", for_s=0.6), (STRAIN,), 100.0),
)

RING = (
    *(
        Case(f"cable cut behind {place} of 3 terminals", cut(place), counted=("cuts",), said="the ring is cut between")
        for place in range(4)
    ),
    *_FRAMES,
    Case("cable cut at two places", cut(1, 2), CUT_OFF, 200.0, ("wrong_working_counter",)),
    _WITHOUT_POWER,
)


def _on_the_drive(kind: str, name: str, said: str) -> Case:
    """What takes a drive out of operation by itself; it is told why, and comes back by `reset` and `arm` alone."""
    return Case(name, inject(kind, terminal="amplifier"), _NOT_OK, 50.0, ("drive_losses",), said=said)


DRIVE = (
    _on_the_drive("fault", "fault of the drive, 0x3210", "DC link over-voltage"),
    _on_the_drive("torque_off", "safe torque off", "left Operation enabled"),
    _on_the_drive("mode", "the drive shows another mode", "mode"),
    Case(
        "the drive stays where it is", inject("stuck", terminal="amplifier"), note="held, it is asked for nothing else"
    ),
    *_FRAMES,
    _LEFT_OP,
    _WITHOUT_POWER,
    Case("cable cut behind the first terminal", cut(1), CUT_OFF, 200.0, ("wrong_working_counter",)),
    _MAILBOX,
)
