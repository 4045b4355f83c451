"""``python -m tools.record_soak``: rows of virtual time recorded without loss, at 5 million values a second or more.

This process writes telemetry rows into a ring as a loop would, seven times as fast as the real one; the recorder reads
them beside it. Prints how fast, what was lost, how large the file is, and compares it with what was written.
"""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from micromanip.host.shared_memory import RING, RING_ROWS, Segments
from micromanip.recordings import open_telemetry
from micromanip.recordings.blocks import columns_of_rows
from micromanip.rt import mailbox as w
from micromanip.rt.telemetry import ROW
from micromanip.rt.tell import tell
from micromanip.settings.check import prepare
from micromanip.virtual.cell import VirtualCell

VALUES_PER_S, SECONDS, BATCH = 5_000_000, 20.0, 500
SIMULATED = Path(__file__).parents[1] / "config" / "simulated.yaml"


def tracked(seconds: float) -> np.ndarray:
    """Rows of the simulated cell, tracking, in virtual time."""
    prepared = prepare(SIMULATED)
    cell = VirtualCell(prepared.parameters, prepared.wiring, prepared.samples, list(prepared.configuration.axes))
    cell.arm()
    return cell.run(seconds)


def main() -> int:
    """0 where every row is in the file, bit for bit."""
    rows, columns = tracked(3.0), len(columns_of_rows(ROW))
    segments = Segments.create(64, np.zeros((1, 3)))
    ring = segments.ring.record(RING)
    count = round(VALUES_PER_S * SECONDS / columns) // BATCH * BATCH
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "soak.mcap"
        orders = {"descriptors": segments.descriptors, "file": str(file), "configuration": "", "sha256": ""}
        recorder = subprocess.Popen(
            [sys.executable, "-m", "micromanip.host.recording.recorder"],
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, pass_fds=segments.descriptors, text=True,
        )  # fmt: skip
        assert recorder.stdin is not None
        assert recorder.stdout is not None
        recorder.stdin.write(json.dumps(orders | {"axes": ["x", "y", "z"], "period_ns": 100_000}) + "\n")
        recorder.stdin.flush()
        assert json.loads(recorder.stdout.readline()) == {"open": True}
        recorder.stdin.write("-1\n")
        recorder.stdin.flush()
        began_s = time.monotonic()
        for first in range(0, count, BATCH):
            part = rows[np.arange(first, first + BATCH) % len(rows)]
            part["cycle"] = np.arange(first, first + BATCH)
            ring["rows"][np.arange(first, first + BATCH) % RING_ROWS] = part
            tell(ring["words"], w.RING_HEAD, first + BATCH)
            time.sleep(max(0.0, began_s + (first + BATCH) * columns / VALUES_PER_S - time.monotonic()))
        took_s = time.monotonic() - began_s
        recorder.stdin.close()
        *_, last = recorder.stdout.read().splitlines()
        recorder.wait()
        size, written = file.stat().st_size, 0
        for part in open_telemetry(file).rows():
            expected = rows[np.arange(written, written + len(part)) % len(rows)]
            expected["cycle"] = np.arange(written, written + len(part))
            if part.tobytes() != expected.tobytes():
                print(f"differs after row {written}")
                return 1
            written += len(part)
    print(last)
    print(f"{count} rows of {columns} values in {took_s:.1f} s: {count * columns / took_s / 1e6:.2f} million values/s")
    print(f"{written} rows in the file, {size / max(written, 1):.1f} bytes a row, of {ROW.itemsize}")
    return 0 if written == count else 1


if __name__ == "__main__":
    sys.exit(main())
