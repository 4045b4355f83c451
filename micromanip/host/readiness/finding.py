"""What was found about one property of the machine, why it matters to the loop, and what mends it."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import asdict, dataclass
from enum import StrEnum
from pathlib import Path
from typing import Any, Self


class Verdict(StrEnum):
    """How a finding bears on the loop's deadlines."""

    GOOD = "good"
    POOR = "poor"
    """Deadlines will be missed now and then, or in time of load."""
    BAD = "bad"
    """With `limits: hardware` the loop refuses to start, or it will be stopped while it runs."""
    UNKNOWN = "unknown"
    """Not to be seen from here."""


@dataclass(frozen=True)
class Finding:
    """One row of the answer; `why` and `mend` are sentences for people, `mend` is None where nothing need be done."""

    name: str
    verdict: Verdict
    found: str
    why: str
    mend: str | None = None

    @classmethod
    def of(cls, name: str, found: str | None, why: str, mend: str | None = None) -> Self:
        """Poor where something mends it, else good; unknown where it could not be seen: None."""
        if found is None:
            return cls(name, Verdict.UNKNOWN, "not to be seen", why)
        return cls(name, Verdict.GOOD if mend is None else Verdict.POOR, found, why, mend)

    def document(self) -> dict[str, Any]:
        """As JSON has it."""
        return asdict(self)


@dataclass(frozen=True)
class Machine:
    """The files in which the kernel tells about itself, below `root`: another folder in tests."""

    root: Path = Path("/")

    def read(self, place: str) -> str | None:
        """Contents of a file without the white space around; None where there is none or it may not be read."""
        try:
            return (self.root / place).read_text(encoding="utf-8", errors="replace").strip()
        except OSError:
            return None

    def listed(self, folder: str, pattern: str) -> list[str]:
        """Names in a folder that match, sorted; none where the folder is missing."""
        return sorted(path.name for path in (self.root / folder).glob(pattern))

    def parameters(self) -> dict[str, str]:
        """The kernel's command line; of a name that stands there twice, the last."""
        words = (self.read("proc/cmdline") or "").split()
        return {name: value for name, _, value in (word.partition("=") for word in words)}


def cpu_list(text: str | None) -> set[int]:
    """CPUs of a list as the kernel writes it, `0-3,8`; what is no number (`(null)`, `domain`) is passed over."""
    found: set[int] = set()
    for part in (text or "").split(","):
        first, _, last = part.strip().partition("-")
        if first.isdigit() and (last or first).isdigit():
            found.update(range(int(first), int(last or first) + 1))
    return found


def listed(numbers: Iterable[int]) -> str:
    """The other way round, each number by itself."""
    return ", ".join(map(str, sorted(numbers))) or "none"
