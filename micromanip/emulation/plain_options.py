"""Options of a driver read plainly: whoever runs the driver has them validated by the driver itself.

A device needs only a few of them, and says clearly what it can't read.
"""

from __future__ import annotations

import difflib
from collections.abc import Iterable, Mapping
from typing import Any

from micromanip.settings.text.source import Source

Place = tuple[str, ...]
Kind = type | tuple[type, ...]


def value(source: Source, place: Place, section: Any, key: str, kind: Kind) -> Any:
    """The value of a key that must be there; raises ConfigError with file, line and key."""
    if not isinstance(section, Mapping) or key not in section:
        raise source.error(place, f"{key} is missing, which the device needs to know")
    found = section[key]
    if not isinstance(found, kind) or isinstance(found, bool):
        raise source.error((*place, key), f"{found!r} can't be its {key}")
    return found


def section(source: Source, place: Place, options: Mapping[str, Any], key: str) -> Mapping[str, Any]:
    """A section that may be left out; raises ConfigError where something else stands there."""
    found = options.get(key) or {}
    if not isinstance(found, Mapping):
        raise source.error((*place, key), "expected a section")
    return {str(name): entry for name, entry in found.items()}


def near(name: str, known: Iterable[str]) -> str:
    """What may have been meant."""
    names = list(known)
    found = difflib.get_close_matches(name, names, 1)
    return f"did you mean {found[0]}?" if found else f"it has {', '.join(names) or 'none'}"
