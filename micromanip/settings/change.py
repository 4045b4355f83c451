"""What a change of each key takes: applied while tracking, only with the outputs at rest, or only by a new start."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from micromanip.settings.schema.model import Configuration
from micromanip.settings.schema.reference import File
from micromanip.settings.text.place import Path

LIVE, DISARM, RESTART = "live", "needs disarm", "needs restart"

RULES: tuple[tuple[str, str], ...] = (
    ("schema_version", RESTART),
    ("loop.**", RESTART),
    ("control.**", RESTART),
    ("start.**", DISARM),
    ("drivers.**", RESTART),
    ("signals.*.max_age_us", LIVE),
    ("signals.*.range_um", LIVE),
    ("signals.**", RESTART),
    ("outputs.*.range_V", DISARM),
    ("outputs.*.slew_V_per_ms", DISARM),
    # also park_V: an output at rest would move to another one without being armed; `identify` reads the current in the
    # file that it is given
    ("outputs.**", RESTART),
    ("switches.**", RESTART),
    ("faults.**", LIVE),
    ("shadow.**", LIVE),
    ("reference.target_um.**", LIVE),
    ("reference.frame.signals", RESTART),
    ("reference.path", RESTART),  # the samples' memory is made when the loop starts
    ("reference.**", DISARM),
    ("axes.*.mode", DISARM),
    ("axes.*.centre_um", DISARM),
    ("axes.*.setpoint.range_um", DISARM),
    ("axes.*.setpoint.slew_um_per_ms", LIVE),
    ("axes.*.hysteresis.**", LIVE),
    ("axes.*.hysteresis_affine.**", LIVE),  # kept for `evaluate`, which reads the file; nothing that runs uses it
    ("axes.*.inner.**", LIVE),
    ("axes.*.outer.**", LIVE),
    ("axes.*.faults.**", LIVE),
    ("axes.*.authority_percent", LIVE),
    ("axes.*.commissioned.**", LIVE),
    ("arm_on_start", RESTART),
    ("simulation.**", RESTART),  # of `simulate-device`, which does not hear of what is set here
)
"""The first rule that fits counts; ``*`` is one name, ``**`` any number of parts, also none."""

ABSENT = object()
"""Stands for a key that a configuration does not have."""

Values = dict[Path, Any]


_SPLIT = {pattern: tuple(pattern.split(".")) for pattern, _ in RULES}
_NEEDED = dict(RULES)


def rule(path: Path) -> str | None:
    """The rule that fits `path`; None where none does."""
    return next((pattern for pattern, parts in _SPLIT.items() if fits(parts, path)), None)


def needed(path: Path) -> str:
    """What a change of the key at `path` takes; of one that no rule knows: a new start."""
    return _NEEDED.get(rule(path) or "", RESTART)


def fits(pattern: tuple[str, ...], path: Path) -> bool:
    """Whether a split pattern of a rule means the key at `path`."""
    if pattern[0] != path[0]:
        return False
    if pattern[-1] == "**":
        pattern, path = pattern[:-1], path[: len(pattern) - 1]
    return len(pattern) == len(path) and all(wanted in ("*", part) for wanted, part in zip(pattern, path, strict=True))


def values(configuration: Configuration) -> Values:
    """Every key and its value, defaults too; a list is one value."""
    return {path: value for path, value in leaves(configuration.model_dump(mode="json")).items() if value != {}}


def leaves(document: Mapping[str, Any]) -> Values:
    """Every key of a document and its value; a list is one value, and so is a section without keys."""
    return dict(_leaves((), document))


def _leaves(path: Path, value: Any) -> Iterator[tuple[Path, Any]]:
    if not isinstance(value, Mapping) or (path and not value):
        yield path, value
    else:
        for key, entry in value.items():
            yield from _leaves((*path, key), entry)


def changed(old: Configuration, new: Configuration) -> dict[Path, tuple[Any, Any]]:
    """Keys whose values differ, each with both; `ABSENT` for one that is not there."""
    return differing(values(old), values(new))


def differing(before: Values, after: Values) -> dict[Path, tuple[Any, Any]]:
    """The same of keys and values."""
    pairs = {path: (before.get(path, ABSENT), after.get(path, ABSENT)) for path in {**before, **after}}
    return {path: pair for path, pair in pairs.items() if pair[0] != pair[1]}


def needs(old: Configuration, new: Configuration) -> dict[Path, str]:
    """What each changed key takes, the names and the order of drivers and axes considered."""
    found = {path: needed(path) for path in changed(old, new)}
    if File in (type(old.reference), type(new.reference)):
        found |= {path: RESTART for path in found if path[0] == "reference"}
    for section in ("drivers", "signals", "outputs", "axes"):
        before, after = list(getattr(old, section)), list(getattr(new, section))
        if set(before) != set(after):
            added_or_removed = set(before) ^ set(after)
            found |= {path: RESTART for path in found if path[0] == section and path[1] in added_or_removed}
        elif before != after and section in ("drivers", "axes"):  # their order is that of the loop's records
            found[section,] = RESTART
    return found
