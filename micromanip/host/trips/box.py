"""One trip as a file: a ``.npz`` without pickles, so that any numpy reads it.

- ``rows``: each cycle from 2 s before to 0.5 s after the trip (``micromanip.rt.records.ROW``)
- ``parameters``: each set of parameters that was in force in them; a row's ``version`` names one
- ``state``: the loop's whole state (1,) as soon as the trip was seen
- ``events``: the faults and warnings that were raised last, in their order (``micromanip.rt.records.EVENT``)
- ``meta``: a JSON document: the trip, the configuration's text and hash, the axes, the clocks (see `Box.meta`)
"""

from __future__ import annotations

import json
import os
import zipfile
import zlib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from micromanip.errors import CheckFailed
from micromanip.files.regular_file import open_regular

FORMAT = 1
PARTIAL = ".part"
_PARTS = ("rows", "parameters", "state", "events")


@dataclass(frozen=True)
class Box:
    """What is known of one trip.

    `meta` has the keys ``format``, ``trip`` (code, number, axis, value, limit, cycle, message), ``complete``,
    ``utc``, ``monotonic_ns`` and ``utc_ns`` (both of the trip), ``period_ns``, ``axes``, ``configuration`` (its text),
    ``sha256``, ``path``.
    """

    meta: dict[str, Any]
    rows: NDArray[Any]
    parameters: NDArray[Any]
    state: NDArray[Any]
    events: NDArray[Any]

    @property
    def trip(self) -> dict[str, Any]:
        """Code, number, axis, value, limit, cycle and message of the trip."""
        trip: dict[str, Any] = self.meta["trip"]
        return trip

    def save(self, file: Path) -> None:
        """Write the file whole or not at all: once it has its name it is on the disk. Raises OSError."""
        write = np.savez_compressed if self.meta["complete"] else np.savez  # the first must be quick
        partial = file.with_name(f".{file.name}.{os.getpid()}{PARTIAL}")
        try:
            with partial.open("wb") as stream:
                write(
                    stream,
                    allow_pickle=False,
                    meta=np.array(json.dumps(self.meta)),
                    **{part: getattr(self, part) for part in _PARTS},
                )
                stream.flush()
                os.fsync(stream.fileno())
            partial.replace(file)
        except BaseException:
            partial.unlink(missing_ok=True)
            raise
        folder = os.open(file.parent, os.O_RDONLY)
        try:
            os.fsync(folder)
        finally:
            os.close(folder)

    @classmethod
    def load(cls, file: Path) -> Box:
        """Read a file; raises CheckFailed where it is none, or damaged."""
        try:
            with open_regular(file) as stream, np.load(stream, allow_pickle=False) as stored:
                meta = json.loads(str(stored["meta"]))
                if meta["format"] != FORMAT:
                    raise CheckFailed(f"{file} has format {meta['format']}; this version reads format {FORMAT}")
                return cls(meta, *(stored[part] for part in _PARTS))
        except OSError as problem:
            raise CheckFailed(f"{file} can't be read: {problem.strerror or problem}") from problem
        except (ValueError, LookupError, TypeError, EOFError, zipfile.BadZipFile, zlib.error) as problem:
            raise CheckFailed(f"{file} is no black box, or it is damaged") from problem
