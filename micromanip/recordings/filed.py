"""What a file says of the program that wrote it: the layout of its parameters, and the sources of its cycle."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from micromanip import rt
from micromanip.rt.records import CELL_PARAMETERS


def _renamed(dtype: np.dtype[Any], names: Mapping[str, str]) -> np.dtype[Any]:
    """The same bytes; fields of the record, and of those in it, are called as `names` says."""
    if dtype.subdtype is not None:
        base, shape = dtype.subdtype
        return np.dtype((_renamed(base, names), shape))
    if dtype.names is None or dtype.fields is None:
        return dtype
    fields = [(names.get(name, name), _renamed(field[0], names), field[1]) for name, field in dtype.fields.items()]
    called, formats, offsets = zip(*fields, strict=True)
    return np.dtype({"names": called, "formats": formats, "offsets": offsets, "itemsize": dtype.itemsize})


FILED_PARAMETERS = _renamed(CELL_PARAMETERS, {"K_V_per_um": "gain"})
"""As recordings and trips have them: what was called otherwise in the first of them is still called that there."""


def sources_of_cycle() -> str:
    """What tells two versions of the cycle apart: a hash of all sources of `micromanip.rt`, 16 digits."""
    folder = Path(rt.__file__).parent
    hashed = hashlib.sha256()
    for source in sorted(folder.rglob("*.py")):
        hashed.update(source.read_bytes())
    return hashed.hexdigest()[:16]
