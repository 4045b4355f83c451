"""The page of all faults in Markdown: their words from ``micromanip/faults.toml``, their limits from the schema.

``make docs`` writes ``docs/faults.md`` from it; a test compares the two.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator, Mapping
from typing import Any

from pydantic import BaseModel

from micromanip.faults import BY_NAME, FaultKind
from micromanip.rt.supervisor import AT_ONCE, BEHIND, FOLLOWED, MANY, RELAPSED, REMEMBERED
from micromanip.settings.schema.faults import LOOP_STUCK_S, SIMULATION, SWING_S, SWINGS, Faults
from micromanip.settings.text import units

_INTRODUCTION = """\
# Faults

Generated from `micromanip/faults.toml` and the defaults in `micromanip/settings/schema/faults.py` by `make docs`; edit
them there.

A fault stays latched until `micromanip reset`; no axis arms itself again. Every trip writes a black box:
`micromanip trip show` prints the newest one in the order of events. `<value>` is the measured value, `<limit>` the
limit it exceeded. Limits are those of `limits: hardware`; brackets show those of `limits: simulation` where they
differ.
"""
_REACTIONS = {
    "hold": "HOLD, then ramp to park",
    "ramp": "ramp to park",
    "off": "amplifier off, outputs to park at the slew limit, all controller memories cleared",
}


def render() -> str:
    """The whole page, in the order of the codes."""
    return "\n".join([_INTRODUCTION, *(_section(kind) for kind in sorted(BY_NAME.values(), key=lambda k: k.code))])


def _section(kind: FaultKind) -> str:
    limits = f" Limits: [`faults.{kind.section}`](configuration.md#faults{_anchor(kind.section)})."
    defaults = dict(_defaults(kind.section))
    return f"""\
## {kind.code}: {kind.what.format(value=_Placeholder("`<value>`"), limit=_Placeholder("`<limit>`"))}

**Detection**: {_sentence(kind.detection, defaults)}{limits if kind.section else ""}

**Reaction**: {_sentence(kind.reaction, defaults)}

**Causes**: {"; ".join(kind.likely_causes)}.

**Next**: {kind.next_step}
"""


def _anchor(section: str) -> str:
    return section.replace(".", "")


def _sentence(text: str, defaults: Mapping[str, str]) -> str:
    sentence = text.format(**defaults)
    return sentence[0].upper() + sentence[1:]


def _defaults(section: str) -> Iterator[tuple[str, str]]:
    """Every limit that a text may name, in words: those of its section, and those that nobody can change."""
    yield "swings", str(SWINGS)
    yield "swing_s", f"{SWING_S:g}"
    yield "behind", f"{BEHIND:g}"
    yield "far", str(FOLLOWED)
    yield "relapsed", str(RELAPSED)
    yield "unseen", f"{MANY:g}"
    yield "at_once", str(AT_ONCE)
    yield "remembered", str(REMEMBERED)
    yield "stuck_s", _in_both("stuck_s", LOOP_STUCK_S["hardware"], LOOP_STUCK_S["simulation"])
    if section:
        hardware, simulation = _of_hardware(section), _of_simulation(section)
        for key, value in hardware:
            yield key, _REACTIONS[value] if key == "reaction" else _in_both(key, value, simulation.get(key, value))


def _of_hardware(section: str) -> BaseModel:
    model: BaseModel = Faults()
    for name in section.split("."):
        model = getattr(model, name)
    return model


def _of_simulation(section: str) -> Mapping[str, Any]:
    """What the set `simulation` has otherwise."""
    found: Mapping[str, Any] = SIMULATION
    for name in section.split("."):
        found = found.get(name, {})
    return found


def _in_both(key: str, hardware: Any, simulation: Any) -> str:
    other = "" if simulation == hardware else f" (simulation: {_in_words(key, simulation)})"
    return _in_words(key, hardware) + other


def _in_words(key: str, value: Any) -> str:
    if value is None:
        return "never"
    _, unit = units.split(key)
    shown = " and ".join(f"{bound:g}" for bound in value) if isinstance(value, tuple) else f"{value:g}"
    return shown if unit is None else f"{shown} {unit.replace('_per_', '/').replace('percent', '%')}"


class _Placeholder(str):
    """Stands for a number in a format string, whatever its format."""

    __slots__ = ()

    def __format__(self, _specification: str) -> str:
        return str(self)


if __name__ == "__main__":
    sys.stdout.write(render())
