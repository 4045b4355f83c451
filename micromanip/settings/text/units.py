"""The unit that stands at the end of a key: ``Ti_ms`` is in milliseconds, ``K_V_per_um`` in volts per micrometre."""

from __future__ import annotations

import re

_WORDS = {
    "ns": "nanoseconds",
    "us": "microseconds",
    "ms": "milliseconds",
    "s": "seconds",
    "min": "minutes",
    "h": "hours",
    "cycles": "loop cycles",
    "Hz": "hertz",
    "hz": "hertz",
    "kHz": "kilohertz",
    "MHz": "megahertz",
    "nm": "nanometres",
    "um": "micrometres",
    "mm": "millimetres",
    "m": "metres",
    "deg": "degrees",
    "rad": "radians",
    "mV": "millivolts",
    "V": "volts",
    "kV": "kilovolts",
    "mA": "milliamperes",
    "mN": "millinewtons",
    "N": "newtons",
    "kN": "kilonewtons",
    "kg": "kilograms",
    "percent": "percent",
    "baud": "baud",
    "bits": "bits",
    "bytes": "bytes",
}
_POWERS = {"": "", "2": " squared", "3": " cubed"}
_ONE = "|".join(sorted(_WORDS, key=len, reverse=True))
_UNIT = re.compile(rf"(?P<over>{_ONE})?(?P<per>(?(over)_)per_(?P<under>{_ONE})(?P<power>[23]?))?")
_KEY = re.compile(rf"(?P<stem>.+?)_(?P<unit>(?=.){_UNIT.pattern})")


def split(key: str) -> tuple[str, str | None]:
    """Stem and unit of a key: ``("K", "V_per_um")``; a key without a unit is all stem.

    A key that is all unit, such as ``um_per_s``, has an empty stem.
    """
    whole = _UNIT.fullmatch(key)
    if whole and whole["over"] and whole["per"]:
        return "", key
    match = _KEY.fullmatch(key)
    return (match["stem"], match["unit"]) if match else (key, None)


def words(unit: str) -> str | None:
    """``V_per_um`` in words, "volts per micrometre", ``per_V`` "per volt"; None if it isn't a unit."""
    match = _UNIT.fullmatch(unit)
    if not unit or match is None:
        return None
    over = [_WORDS[match["over"]]] if match["over"] else []
    under = [f"per {_WORDS[match['under']].removesuffix('s')}{_POWERS[match['power']]}"] if match["per"] else []
    return " ".join(over + under)


def words_for(key: str) -> str | None:
    """The unit a key's value is in, in words; None if the key names none."""
    _, unit = split(key)
    return None if unit is None else words(unit)
