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


class McapRecording:
    """An open file and what has been put into it."""

    def __init__(self, orders: Mapping[str, Any]) -> None:
        """Raises OSError, also where the file exists already."""
        self.file = Path(orders["file"])
        self.written = 0
        self._lost = 0
        self._axes: list[str] = orders["axes"]
        self._period_ns: int = orders["period_ns"]
        self._versions: set[int] = set()
        self._codec = BlockCodec.of(ROW)
        self._unix_ns = time.time_ns() - time.monotonic_ns()
        self._next_scalars_ns = -1
        self._stream = _Pieces(self.file)
        try:
            self._writer: Any = Writer(self._stream, chunk_size=_CHUNK_BYTES)  # type: ignore[arg-type]  # write, tell, flush
            self._writer.start(profile="micromanip")
            self._describe(orders)
            self._channels()
            self._stream.commit()
        except BaseException:
            with contextlib.suppress(OSError):
                self._stream.close()
                self.file.unlink()
            raise

    def begin(self, state: Any, samples: NDArray[np.float64] | None = None) -> None:
        """Store a snapshot of the loop, which the rows follow, and what the source `file` plays."""
        if samples is not None:
            self._attach(header.SAMPLES, np.asarray(samples))
        self._attach(header.STATE, np.array([state], CELL_STATE))
        self.go_on(int(state["cycle"]))

    def keep(self, state: Any) -> None:
        """Store a snapshot on the way."""
        self._attach(header.state_file(int(state["cycle"])), np.array([state], CELL_STATE))

    def go_on(self, cycle: int) -> None:
        """Begin without a snapshot, behind another file."""
        # the first chunk brings what readers must know of the rows
        self.mark(header.BEGAN, cycle, "recorder", time.monotonic_ns())

    def append(self, rows: NDArray[Any], slots: Any) -> None:
        """Add rows; a new parameter version brings its parameters, one of `slots`, with it.

        Raises OSError where the disk takes no more; what was appended before is then in the file.
        """
        if len(rows) == 0:
            return
        for version in np.unique(rows["version"]):
            if int(version) not in self._versions:
                self._versions.add(int(version))
                found = slots[slots["version"] == version].view(CELL_PARAMETERS)
                self._attach_packed(header.parameters_file(int(version)), found)
        self._scalars(rows)
        for first in range(0, len(rows), _BLOCK_ROWS):
            block = rows[first : first + _BLOCK_ROWS]
            self._message(self._blocks, int(block["time_ns"][0]), self._codec.encode(block))
        self._writer.flush()
        self._stream.commit()
        self.written += len(rows)

    @property
    def size_bytes(self) -> int:
        """Size of the file so far."""
        return self._stream.tell()

    def note_lost(self, lost: int) -> None:
        """`lost` rows are missing so far."""
        self._lost = lost

    def mark(self, text: str, cycle: int, by: str, time_ns: int) -> None:
        """Somebody's remark: the cycle, and the time on the clock of the loop, at which it was made."""
        document = {"text": text, "cycle": cycle, "by": by, "time": _iso(time_ns + self._unix_ns)}
        self._message(self._marks, time_ns, json.dumps(document).encode())
        self._writer.flush()
        self._stream.commit()

    def close(self) -> None:
        """End the file in order, with its index. Raises OSError; what was written before is then whole."""
        try:
            self._writer.add_metadata(header.END, {"rows": str(self.written), "lost": str(self._lost)})
            self._writer.finish()
            self._stream.commit()
        finally:
            self._stream.close()

    def _describe(self, orders: Mapping[str, Any]) -> None:
        now_ns = time.monotonic_ns()
        about = {
            "format": header.FORMAT,
            "axes": json.dumps(self._axes),
            "period_ns": str(self._period_ns),
            "sha256": orders["sha256"],
            "sources": header.sources_of_cycle(),
            "began": _iso(now_ns + self._unix_ns),
            "unix_ns_of_time_0": str(self._unix_ns),
        }
        self._writer.add_metadata(header.ABOUT, about)
        text = orders["configuration"].encode()
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
        self._axis = [self._json_channel(header.axis_topic(axis), "micromanip.Axis", scalars) for axis in self._axes]
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
