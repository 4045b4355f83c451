"""A recording as an MCAP file: blocks of rows for programs, fifty scalars a second for viewers.

What is written between two flushes goes to the file in one piece, and a piece that the disk does not take is cut off
again: whatever ends the recorder, the file is whole up to a flush. ``micromanip.recordings.file_header`` has the names.
"""

from __future__ import annotations

import contextlib
import io
import json
import math
import os
import time
from collections import deque
from collections.abc import Mapping
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
from mcap.writer import Writer
from numpy.typing import NDArray

from micromanip.recordings import file_header as header
from micromanip.recordings.blocks import BlockCodec
from micromanip.rt.records import CELL_PARAMETERS, CELL_STATE
from micromanip.rt.states import STATE_NAMES
from micromanip.rt.telemetry import AXIS_ROW, ROW

_BLOCK_ROWS = 1000
_SCALARS_NS = 20_000_000
_CHUNK_BYTES = 1 << 30
"""A chunk ends when it is flushed, not when it is large."""
_DECIMALS = 6
_SCALARS = [name for name in AXIS_ROW.names or () if AXIS_ROW[name].kind == "f"]


def numbered(file: Path, number: int) -> Path:
    """``night-0001.mcap`` of ``night.mcap``."""
    return file.with_name(f"{file.stem}-{number:04d}{file.suffix}")


class McapRecording:
    """An open recording and what has been put into it.

    With ``segment_s`` in its orders it goes on from file to file without a gap; each is ended before the next begins,
    and the oldest go once all have reached ``quota_bytes``.
    """

    def __init__(self, orders: Mapping[str, Any]) -> None:
        """Raises OSError, also where the file exists already."""
        self._orders = orders
        self._axes: list[str] = orders["axes"]
        self._period_ns: int = orders["period_ns"]
        self.goes_on = bool(orders.get("segment_s"))
        """Whether it is a series of numbered files."""
        self._most_rows = max(1, round(orders["segment_s"] * 1e9 / self._period_ns)) if self.goes_on else math.inf
        self._ended: deque[tuple[Path, int]] = deque()
        self._number = 1
        self._before = self._lost = 0
        self._unix_ns = time.time_ns() - time.monotonic_ns()
        self._open()

    def _open(self) -> None:
        self._rows, self._versions = 0, set[int]()
        self._codec = BlockCodec.of(ROW)
        self._next_scalars_ns = -1
        self._stream = _Pieces(self.file)
        try:
            self._writer: Any = Writer(self._stream, chunk_size=_CHUNK_BYTES)  # type: ignore[arg-type]  # write, tell, flush
            self._writer.start(profile="micromanip")
            self._describe()
            self._channels()
            self._stream.commit()
        except BaseException:
            with contextlib.suppress(OSError):
                self._stream.close()
                self.file.unlink()
            raise

    @property
    def file(self) -> Path:
        """The one that is being written."""
        file = Path(self._orders["file"])
        return numbered(file, self._number) if self.goes_on else file

    @property
    def written(self) -> int:
        """Rows so far, also those that have been removed again."""
        return self._before + self._rows

    def begin(self, state: Any, samples: NDArray[np.float64] | None = None) -> None:
        """Store a snapshot of the loop, which the rows follow, and what the source `file` plays, in the first file."""
        if samples is not None:
            self._attach(header.SAMPLES, np.asarray(samples))
        self._attach(header.STATE, np.array([state], CELL_STATE))
        self._mark_begin(int(state["cycle"]))

    def keep(self, state: Any) -> None:
        """Store a snapshot on the way."""
        self._attach(f"{header.STATES}{state['cycle']}.npy", np.array([state], CELL_STATE))

    def _mark_begin(self, cycle: int) -> None:
        """The first chunk of a file: it brings what readers must know of the rows."""
        self.mark(header.BEGAN, cycle, "recorder", time.monotonic_ns())

    def append(self, rows: NDArray[Any], slots: Any) -> None:
        """Add rows; a new parameter version brings its parameters, one of `slots`, with it.

        Raises OSError where the disk takes no more; what was appended before is then in the file.
        """
        while len(rows):
            if self._rows >= self._most_rows:
                self._next(int(rows["cycle"][0]))
            room = int(min(self._most_rows - self._rows, len(rows)))
            self._append(rows[:room], slots)
            rows = rows[room:]
        while self._ended and self.size_bytes > self._orders["quota_bytes"]:  # what is being written stays
            self._ended.popleft()[0].unlink(missing_ok=True)

    def _next(self, cycle: int) -> None:
        self.close()
        self._ended.append((self.file, self._stream.tell()))
        self._before += self._rows
        self._number += 1
        self._open()
        self._mark_begin(cycle)

    def _append(self, rows: NDArray[Any], slots: Any) -> None:
        for version in np.unique(rows["version"]):
            if int(version) not in self._versions:
                self._versions.add(int(version))
                found = slots[slots["version"] == version].view(CELL_PARAMETERS)
                self._attach_packed(f"{header.PARAMETERS}{version}.npz", found)
        self._scalars(rows)
        for first in range(0, len(rows), _BLOCK_ROWS):
            block = rows[first : first + _BLOCK_ROWS]
            self._message(self._blocks, int(block["time_ns"][0]), self._codec.encode(block))
        self._writer.flush()
        self._stream.commit()
        self._rows += len(rows)

    @property
    def size_bytes(self) -> int:
        """Size of all files that are there, so far."""
        return sum(size for _, size in self._ended) + self._stream.tell()

    def note_lost(self, lost: int) -> None:
        """`lost` rows are missing so far, of all files."""
        self._lost = lost

    def mark(self, text: str, cycle: int, by: str, time_ns: int) -> None:
        """Somebody's remark: the cycle, and the time on the clock of the loop, at which it was made."""
        document = {"text": text, "cycle": cycle, "by": by, "time": _iso(time_ns + self._unix_ns)}
        self._message(self._marks, time_ns, json.dumps(document).encode())
        self._writer.flush()
        self._stream.commit()

    def close(self) -> None:
        """End the present file in order, with its index. Raises OSError; what was written before is then whole."""
        try:
            self._writer.add_metadata(header.END, {"rows": str(self._rows), "lost": str(self._lost)})
            self._writer.finish()
            self._stream.commit()
        finally:
            self._stream.close()

    def _describe(self) -> None:
        now_ns = time.monotonic_ns()
        about = {
            "format": header.FORMAT,
            "axes": json.dumps(self._axes),
            "period_ns": str(self._period_ns),
            "sha256": self._orders["sha256"],
            "sources": header.sources_of_cycle(),
            "began": _iso(now_ns + self._unix_ns),
            "unix_ns_of_time_0": str(self._unix_ns),
        }
        self._writer.add_metadata(header.ABOUT, about)
        text = self._orders["configuration"].encode()
        self._writer.add_attachment(0, now_ns + self._unix_ns, header.CONFIGURATION, "application/yaml", text)

    def _channels(self) -> None:
        writer, encoding = self._writer, header.BLOCKS_ENCODING
        document = json.dumps(self._codec.document()).encode()
        self._blocks = writer.register_channel(
            header.BLOCKS_TOPIC, encoding, writer.register_schema(header.BLOCKS_SCHEMA, encoding, document)
        )
        cell = dict.fromkeys(("cycle", "state", "fault", "lateness_us", "compute_us", "lines"), "number")
        self._cell = self._json_channel(header.CELL_TOPIC, "micromanip.Cell", {**cell, "state_name": "string"})
        scalars = dict.fromkeys(_SCALARS, "number")
        self._axis = [self._json_channel(f"/axis/{axis}", "micromanip.Axis", scalars) for axis in self._axes]
        marks = {"text": "string", "cycle": "integer", "by": "string", "time": "string"}
        self._marks = self._json_channel(header.MARKS_TOPIC, "micromanip.Mark", marks)

    def _json_channel(self, topic: str, name: str, fields: Mapping[str, str]) -> int:
        schema = {"type": "object", "properties": {field: {"type": kind} for field, kind in fields.items()}}
        number = self._writer.register_schema(name, "jsonschema", json.dumps(schema).encode())
        return int(self._writer.register_channel(topic, "json", number))

    def _scalars(self, rows: NDArray[Any]) -> None:
        """What viewers plot: a row each 20 ms, without what is not known."""
        times = rows["time_ns"]
        at = int(np.searchsorted(times, self._next_scalars_ns))
        while at < len(rows):
            row = rows[at]
            now_ns = int(row["time_ns"])
            cell: dict[str, Any] = {name: int(row[name]) for name in ("cycle", "state", "fault", "lines")}
            cell |= {f"{name}_us": int(row[f"{name}_ns"]) / 1e3 for name in ("lateness", "compute")}
            cell["state_name"] = STATE_NAMES[cell["state"]]
            self._message(self._cell, now_ns, json.dumps(cell).encode())
            for channel, values in zip(self._axis, row["axis"], strict=False):
                known = {name: round(v, _DECIMALS) for name in _SCALARS if math.isfinite(v := float(values[name]))}
                self._message(channel, now_ns, json.dumps(known).encode())
            self._next_scalars_ns = now_ns + _SCALARS_NS
            at = int(np.searchsorted(times, self._next_scalars_ns))

    def _message(self, channel: int, now_ns: int, data: bytes) -> None:
        time_ns = now_ns + self._unix_ns
        self._writer.add_message(channel, log_time=time_ns, publish_time=time_ns, data=data)

    def _attach(self, name: str, values: NDArray[Any]) -> None:
        content = io.BytesIO()
        np.save(content, values, allow_pickle=False)
        self._add(name, "application/x-npy", content)

    def _attach_packed(self, name: str, values: NDArray[Any]) -> None:
        """Most of a set of parameters is room that is not used: about a sixth is left."""
        content = io.BytesIO()
        np.savez_compressed(content, parameters=values)
        self._add(name, "application/zip", content)

    def _add(self, name: str, kind: str, content: io.BytesIO) -> None:
        now_ns = time.monotonic_ns() + self._unix_ns
        self._writer.add_attachment(0, now_ns, name, kind, content.getvalue())


class _Pieces:
    """A new file to which a piece is added whole, or not at all."""

    def __init__(self, file: Path) -> None:
        self._descriptor = os.open(file, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW | os.O_CLOEXEC, 0o666)
        self._piece = bytearray()
        self._end = 0

    def write(self, data: bytes) -> int:
        """Put `data` behind the piece that is being made."""
        self._piece += data
        return len(data)

    def tell(self) -> int:
        """The end of the file as it will be."""
        return self._end + len(self._piece)

    def flush(self) -> None:
        """The library's own, which comes in the middle of a piece."""

    def commit(self) -> None:
        """Write what has come since the last time. Raises OSError, and the file is as it was."""
        rest = memoryview(bytes(self._piece))
        self._piece.clear()
        size = len(rest)
        try:
            while rest:
                rest = rest[os.write(self._descriptor, rest) :]
        except OSError:
            with contextlib.suppress(OSError):
                os.ftruncate(self._descriptor, self._end)
                os.lseek(self._descriptor, self._end, os.SEEK_SET)
            raise
        self._end += size

    def close(self) -> None:
        """Let the file go; what was not committed is dropped."""
        os.close(self._descriptor)


def _iso(unix_ns: int) -> str:
    return datetime.fromtimestamp(unix_ns * 1e-9, UTC).isoformat(timespec="milliseconds")
