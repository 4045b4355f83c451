"""Units of columns: in names ("x (mm)", "u [V]", "t_ms", "t in ms"), in a row of their own, or given; um, V and s."""

from __future__ import annotations

import re
from typing import NamedTuple


class Unit(NamedTuple):
    """What a unit measures, and what a value in it is multiplied by; `base` is the unit that then results."""

    dimension: str
    base: str
    factor: float


def _family(dimension: str, base: str, **factors: float) -> dict[str, Unit]:
    return {name: Unit(dimension, base, factor) for name, factor in factors.items()}


_UNITS = {
    **_family("length", "um", um=1.0, nm=1e-3, pm=1e-6, mm=1e3, cm=1e4, m=1e6, micron=1.0, microns=1.0, micrometer=1.0),
    **_family("length", "um", micrometre=1.0, millimeter=1e3, millimetre=1e3, nanometer=1e-3, meter=1e6, meters=1e6),
    **_family("length", "um", micrometers=1.0, micrometres=1.0, mikrometer=1.0, millimeters=1e3, nanometers=1e-3),
    **_family("length", "um", inch=25_400.0, inches=25_400.0, mil=25.4, mils=25.4),
    **_family("voltage", "V", V=1.0, mV=1e-3, uV=1e-6, kV=1e3, volt=1.0, volts=1.0),
    **_family("time", "s", s=1.0, ms=1e-3, us=1e-6, ns=1e-9, min=60.0, h=3600.0, sec=1.0, secs=1.0, days=86_400.0),
    **_family("time", "s", second=1.0, seconds=1.0, millisecond=1e-3, milliseconds=1e-3, microseconds=1e-6),
    **_family("time", "s", microsecond=1e-6, nanosecond=1e-9, nanoseconds=1e-9, msec=1e-3, usec=1e-6, nsec=1e-9),
    **_family("time", "s", sekunde=1.0, sekunden=1.0, millisekunden=1e-3, mikrosekunden=1e-6, nanosekunden=1e-9),
    **_family("time", "s", millis=1e-3, micros=1e-6),
    **_family("count", "samples", samples=1.0, sample=1.0, cycles=1.0, cycle=1.0, sequence=1.0),
    **_family("current", "A", A=1.0, mA=1e-3, amp=1.0, ampere=1.0, amps=1.0),
    **_family("force", "N", N=1.0, mN=1e-3, kN=1e3),
    **_family("temperature", "C", C=1.0, degC=1.0, **{"°C": 1.0}),
    **_family("angle", "rad", rad=1.0, mrad=1e-3, urad=1e-6, deg=0.017453292519943295),
    **_family("frequency", "Hz", Hz=1.0, kHz=1e3),
    **_family("charge", "C", Coulomb=1.0),
    **_family("ratio", "1", **{"%": 0.01, "1": 1.0}),
}
_WORDS = {name.lower(): unit for name, unit in _UNITS.items() if len(name) > 3}
_MICRO = str.maketrans({"\N{MICRO SIGN}": "u", "\N{GREEK SMALL LETTER MU}": "u"})

_BRACKETS = re.compile(r"^(?P<name>.*?)[\s_]*[(\[{<]\s*(?P<unit>[^()\[\]{}<>]+?)\s*[)\]}>]$")
_BEHIND = re.compile(r"^(?P<name>.*\S)\s*(?:[,/]|\sin\s)\s*(?P<unit>[^\s/]+)$")
_SHORT = "um|µm|μm|nm|mm|V|mV|kV|s|ms|us|µs|μs|ns|sec"
_SUFFIX = re.compile(rf"^(?P<name>.+)_(?P<unit>{_SHORT})(?:_(?P<of>[a-z]\w*))?$")
_APART = re.compile(rf"^(?P<name>.*[^\s/]) +(?P<unit>{_SHORT})$")


def known(unit: str) -> Unit | None:
    """The unit written so, ``µm`` as well as ``um``; None where it is none of ours."""
    plain = unit.strip().translate(_MICRO)
    return _UNITS.get(plain) or _WORDS.get(plain.lower())


def known_time(unit: str) -> Unit | None:
    """The unit that a column of time is in, in capitals too, as in ``Time(S)``; None where it is none of time."""
    found = known(unit) or known(unit.lower())
    return found if found is not None and found.dimension in ("time", "count") else None


def unknown_unit(name: str) -> str | None:
    """What stands in brackets behind a column's name and is no unit of ours: ``in`` of ``y (in)``."""
    found = _BRACKETS.match(name)
    return found["unit"] if found and found["name"] and known(found["unit"]) is None else None


def split_unit(name: str) -> tuple[str, str | None]:
    """A column's name without its unit, and the unit; None where the name states none that is known."""
    for pattern in (_BRACKETS, _BEHIND, _SUFFIX, _APART):
        found = pattern.match(name)
        if found and known(found["unit"]) is not None:
            if pattern is _BEHIND and split_unit(found["name"])[1] is not None:
                break  # a quotient: "feed mm/s" is no time
            of = found.groupdict().get("of")
            return (f"{found['name']}_{of}" if of else found["name"]), found["unit"]
    return name, None
