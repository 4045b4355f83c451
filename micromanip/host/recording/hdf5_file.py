"""A recording as an HDF5 file: the rows as one growing table, as they lie in the memory.

- ``/rows``: every cycle, one compound row each (``micromanip.rt.telemetry.ROW``)
- ``/state``: the loop's whole state at the end of the cycle before the first row
- ``/parameters``: each set of parameters that was in force, in order; a row's ``version`` names one
- attributes: ``configuration`` (its text), ``sha256``, ``axes``, ``period_ns``, ``lost`` (rows the recorder missed so
  far), ``complete`` (the recording was ended, not broken off) and ``problem`` (why it was broken off, where the
  recorder could still say so)
"""

from __future__ import annotations

import contextlib
import errno
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from micromanip.recordings.filed import FILED_PARAMETERS, sources_of_cycle
from micromanip.rt.records import CELL_STATE
from micromanip.rt.telemetry import ROW

ROWS, STATE, PARAMETERS = "rows", "state", "parameters"
LOST, COMPLETE, PROBLEM = "lost", "complete", "problem"
_PROBLEM_BYTES = 200
_CHUNK_ROWS = 1000
_INDEX_BYTES = 65_536
"""More than the file's index grows by with a chunk."""
_NOT_RESERVABLE = (errno.EINVAL, errno.EOPNOTSUPP, errno.ENODEV, errno.ENOSYS)
"""What a file system says that knows no reservations."""


class Hdf5Recording:
    """An open file and what has been put into it.

    Written so that a reader finds all rows up to the last flush however this ends: from `begin` on by HDF5's rules for
    one writer and many readers (what is pointed to is written before what points to it), and only into space
    that the disk has promised beforehand, because HDF5 does not survive a write that fails.
    """

    pause_s = 0.1

    def __init__(self, orders: Mapping[str, Any]) -> None:
        """Raises OSError, also where the file exists already; ImportError where the extra is missing."""
        import h5py  # the extra "recording"

        self.file = h5py.File(orders["file"], "x", libver=("v110", "v110"))
        try:
            self._describe(orders)
        except BaseException:
            with contextlib.suppress(OSError):
                Path(orders["file"]).unlink()
            raise

    def _describe(self, orders: Mapping[str, Any]) -> None:
        for name in ("configuration", "sha256", "axes", "period_ns"):
            self.file.attrs[name] = orders[name]
        self.file.attrs["sources"] = sources_of_cycle()
        self.file.attrs[LOST], self.file.attrs[COMPLETE] = 0, False
        self.file.attrs[PROBLEM] = np.array(b"", f"S{_PROBLEM_BYTES}")  # of fixed length: it is changed in its place
        self.rows = self.file.create_dataset(ROWS, (0,), ROW, maxshape=(None,), chunks=(_CHUNK_ROWS,))
        self.parameters = self.file.create_dataset(PARAMETERS, (0,), FILED_PARAMETERS, maxshape=(None,), chunks=(1,))
        self.versions: set[int] = set()
        self.lost = 0
        self._reserves = True

    @property
    def written(self) -> int:
        """Rows in it."""
        return len(self.rows)

    @property
    def size_bytes(self) -> int:
        """Size of the file so far."""
        return int(self.file.id.get_filesize())

    def begin(self, state: Any, samples: Any = None) -> None:
        """Store the snapshot the rows follow, and what the source `file` plays."""
        if samples is not None:
            self.file.create_dataset("samples", data=samples)
        self.file.create_dataset(STATE, data=np.array([state], CELL_STATE))
        self.file.swmr_mode = True

    def keep(self, state: Any) -> None:
        """Nothing: the file takes no new table once others may read it."""

    def append(self, rows: Any, slots: Any) -> None:
        """Add rows; a new parameter version brings its parameters, one of `slots`, with it.

        Raises OSError where the disk takes no more; what came before is then in the file, and `close` still works.
        """
        if len(rows) == 0:
            return
        for version in np.unique(rows["version"]):
            if int(version) not in self.versions:  # an older one comes back where a promotion is taken back
                self.versions.add(int(version))
                self._extend(self.parameters, slots[slots["version"] == version].view(FILED_PARAMETERS))
        first = _CHUNK_ROWS - self.written % _CHUNK_ROWS
        try:
            for part in np.split(rows, range(first, len(rows), _CHUNK_ROWS)):  # a small disk takes one chunk, not two
                self._extend(self.rows, part)
        finally:
            self.file.flush()

    def note_lost(self, lost: int) -> None:
        """`lost` rows are missing so far."""
        if lost != self.lost:
            self.lost = lost
            self.file.attrs.modify(LOST, lost)

    def mark(self, **mark: Any) -> None:
        """The host refuses marks of a file that takes no new table once others may read it."""

    def close(self, problem: str = "") -> None:
        """End the file in order; `problem` is why it ends early."""
        self.file.attrs.modify(PROBLEM, np.array(problem.encode()[:_PROBLEM_BYTES], f"S{_PROBLEM_BYTES}"))
        self.file.attrs.modify(COMPLETE, not problem)
        self.file.flush()
        self.file.close()

    def _extend(self, dataset: Any, values: Any) -> None:
        start = len(dataset)
        chunk = dataset.chunks[0]
        added = -(-(start + len(values)) // chunk) + (-start // chunk)  # chunks
        if added:
            self._reserve(added * chunk * dataset.dtype.itemsize + _INDEX_BYTES)
        dataset.resize((start + len(values),))
        try:
            dataset[start:] = values
            self.file.flush()
        except (OSError, RuntimeError):
            with contextlib.suppress(OSError, RuntimeError):
                dataset.resize((start,))  # or rows that were never written would be read as zeros
            raise

    def _reserve(self, size: int) -> None:
        """Let the disk promise `size` bytes behind the end. Raises OSError where it can't."""
        if not self._reserves:
            return
        try:
            os.posix_fallocate(self.file.id.get_vfd_handle(), self.file.id.get_filesize(), size)
        except OSError as problem:
            if problem.errno not in _NOT_RESERVABLE:
                raise
            self._reserves = False
