"""The recorder process: telemetry ring to HDF5 until its standard input is closed."""

from __future__ import annotations

import contextlib
import json
import select
import signal
import sys
from typing import Any

import numpy as np

from micromanip.rt.records import CELL_PARAMETERS, CELL_STATE, ROW

from .recording import PARAMETERS, ROWS, STATE
from .ring import RingReader
from .segments import CONTROL, RING, STATUS, Segments

_PAUSE_S = 0.1
_CHUNK_ROWS = 1000
_BATCH_ROWS = 8192


class Recording:
    """An open file and what has been put into it."""

    def __init__(self, orders: dict[str, Any]) -> None:
        import h5py  # the extra "recording"

        self.file = h5py.File(orders["file"], "w", libver="latest")
        for name in ("configuration", "sha256", "axes", "period_ns"):
            self.file.attrs[name] = orders[name]
        self.rows = self.file.create_dataset(ROWS, (0,), ROW, maxshape=(None,), chunks=(_CHUNK_ROWS,))
        self.parameters = self.file.create_dataset(PARAMETERS, (0,), CELL_PARAMETERS, maxshape=(None,), chunks=(1,))
        self.versions: set[int] = set()

    def begin(self, state: Any) -> None:
        """Store the snapshot the rows follow."""
        self.file.create_dataset(STATE, data=np.array([state], CELL_STATE))

    def append(self, rows: Any, slots: Any) -> None:
        """Add rows; a new parameter version brings its parameters, one of `slots`, with it."""
        if len(rows) == 0:
            return
        for version in np.unique(rows["version"]):
            if int(version) not in self.versions:  # an older one comes back where a promotion is taken back
                self.versions.add(int(version))
                self._extend(self.parameters, slots[slots["version"] == version])
        self._extend(self.rows, rows)
        self.file.flush()

    @staticmethod
    def _extend(dataset: Any, values: Any) -> None:
        start = len(dataset)
        dataset.resize((start + len(values),))
        dataset[start:] = values


def main() -> int:
    """Record until standard input ends; the last line on standard output says what there is."""
    for number in (signal.SIGINT, signal.SIGTERM):  # sent to all processes of a service; the host ends this one
        signal.signal(number, signal.SIG_IGN)
    orders = json.loads(sys.stdin.readline())
    segments = Segments.attach(orders["descriptors"], writable=False)
    control, status = segments.control.record(CONTROL), segments.status.record(STATUS)
    reader = RingReader(segments.ring.record(RING))
    try:
        recording = Recording(orders)
    except ImportError:
        print("install the extra first: pip install micromanip[recording]", flush=True)  # noqa: T201
        return 69
    except OSError as problem:
        print(f"{orders['file']} can't be written: {problem}", flush=True)  # noqa: T201
        return 69
    print("open", flush=True)  # noqa: T201
    first = int(sys.stdin.readline() or -1)
    recording.begin(status["snapshot"][0])
    running = True
    while running:
        running = not select.select([sys.stdin], [], [], _PAUSE_S)[0]
        behind = True
        while behind:
            rows = reader.read(_BATCH_ROWS)
            recording.append(rows[rows["cycle"] > first], control["parameters"])
            behind = len(rows) == _BATCH_ROWS
    recording.file.attrs["lost"] = reader.lost
    total = len(recording.rows)
    recording.file.close()
    with contextlib.suppress(BrokenPipeError):  # the host may be dead; the file is complete all the same
        print(f"recorded {total} cycles to {orders['file']}, {reader.lost} lost", flush=True)  # noqa: T201
    return 0


if __name__ == "__main__":
    sys.exit(main())
