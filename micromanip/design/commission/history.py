"""Earlier reports of the same axes beside this one: what each said, and what is other now.

Each report carries its findings as data, so that a later one can read them: nothing else has to be kept.
"""

from __future__ import annotations

import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from ..criterion import Criterion
from .evidence import Evidence

ELEMENT = "findings"
_CARRIED = re.compile(rf'<script type="application/json" id="{ELEMENT}">(.*?)</script>', re.DOTALL)
_MOST = 20


@dataclass(frozen=True)
class Earlier:
    """One report: when it was made, and its criteria and tuning hash by axis."""

    when: str
    criteria: dict[str, tuple[Criterion, ...]]
    hashes: dict[str, str]


@dataclass(frozen=True)
class Changed:
    """A criterion as it was found `before` and `now`; None where it was not judged."""

    name: str
    before: Criterion | None
    now: Criterion | None


def findings_json(when: str, axes: Sequence[Evidence], hashes: Mapping[str, str]) -> str:
    """What a report carries, as JSON that can stand inside a script element."""
    criteria = {each.axis: [asdict(criterion) for criterion in each.criteria] for each in axes}
    text = json.dumps({"when": when, "criteria": criteria, "hashes": dict(hashes)})
    for character in "<>&":
        text = text.replace(character, f"\\u{ord(character):04x}")
    return text


def carried(file: Path) -> Earlier | None:
    """The findings in a report; None where it carries none, or can't be read."""
    try:
        found = _CARRIED.search(file.read_text(encoding="utf-8"))
        return _read(json.loads(found[1])) if found else None
    except (OSError, ValueError, KeyError, TypeError):
        return None


def earlier_reports(folder: Path, name: str, axes: Sequence[str]) -> list[Earlier]:
    """The reports `name` in the run folders of `folder` that are about one of `axes`, the newest first.

    Those that carry no findings, or can't be read, are left out.
    """
    found: list[Earlier] = []
    for file in sorted(folder.glob(f"[0-9]*/{name}"), reverse=True):
        known = carried(file)
        if known is not None and known not in found and not set(axes).isdisjoint(known.criteria):
            found.append(known)
    return found[:_MOST]


def before(axis: str, reports: Sequence[Earlier]) -> Earlier | None:
    """The newest of `reports` about `axis`."""
    return next((each for each in reports if axis in each.criteria), None)


def compared(now: Evidence, then: Earlier) -> list[Changed]:
    """What is not as in the report before; criteria that pass no longer, or again, come first."""
    old = {criterion.name: criterion for criterion in then.criteria[now.axis]}
    new = {criterion.name: criterion for criterion in now.criteria}
    changed = [Changed(name, old.get(name), new.get(name)) for name in {**new, **old}]
    other = [each for each in changed if each.before is None or each.now is None or each.before.value != each.now.value]
    return sorted(other, key=_same_verdict)


def _same_verdict(each: Changed) -> bool:
    return each.before is not None and each.now is not None and each.before.passed == each.now.passed


def _read(document: Any) -> Earlier:
    criteria = {
        str(axis): tuple(
            Criterion(str(axis), str(c["name"]), bool(c["passed"]), str(c["value"]), str(c["limit"])) for c in each
        )
        for axis, each in document["criteria"].items()
    }
    return Earlier(str(document["when"]), criteria, {str(k): str(v) for k, v in document["hashes"].items()})
