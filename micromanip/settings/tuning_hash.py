"""Which tuning a commissioning report belongs to: a hash in the configuration file, compared when it is loaded."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator, Mapping

from micromanip.settings.schema.axis import HASH_DIGITS, Axis
from micromanip.settings.text.digits import rounded
from micromanip.settings.text.place import Finding


def tuning_hash(axis: Axis) -> str:
    """First 16 hexadecimal digits of the SHA-256 over all keys of `axis` that a report is about (``Axis.tuning``).

    Canonical JSON, keys sorted, numbers rounded as where they are written to a file: a file that was written
    and loaded again has the same hash. Defaults count: it is the same whether a key is left out or spelt out.
    """
    text = json.dumps(rounded(axis.tuning()), sort_keys=True, separators=(",", ":"), allow_nan=False)
    return hashlib.sha256(text.encode()).hexdigest()[:HASH_DIGITS]


def changes_since(axes: Mapping[str, Axis]) -> Iterator[Finding]:
    """Each axis whose tuning is not the one that its report is about.

    A report is about both loops, so it stays that of its axis in any mode.
    """
    for name, axis in axes.items():
        if axis.commissioned is not None and axis.commissioned.hash not in {
            tuning_hash(axis.model_copy(update={"mode": mode})) for mode in ("strain", "stage", axis.mode)
        }:
            yield (
                ("axes", name, "commissioned"),
                f"axis {name} was changed after it was commissioned (report {axis.commissioned.report}, "
                f"{axis.commissioned.date}): commission it again, or remove the section commissioned",
            )
