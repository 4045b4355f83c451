"""Blocks of columns: bit for bit what went in, whatever it is; and smaller where it is smooth."""

import json

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from micromanip.recordings.blocks import BlockCodec, columns_of_rows, record_of
from micromanip.rt.telemetry import ROW


def read_back(codec, block):
    """By a codec that knows nothing but the schema, as it stands in a file."""
    return BlockCodec.described(json.loads(json.dumps(codec.document()))).rows(block)


@given(arrays.arrays(np.uint8, st.integers(1, 40).map(lambda n: n * ROW.itemsize)))
def test_any_bytes_come_back(raw):
    """Among them signalling NaNs, denormal numbers, infinities, numbers that are no codes."""
    rows = raw.view(ROW)
    codec = BlockCodec.of(ROW)
    assert read_back(codec, codec.encode(rows)).tobytes() == rows.tobytes()


def motion(count, seed=1):
    """Rows as of a cell that tracks: smooth and noisy columns."""
    noise, t = np.random.default_rng(seed), np.arange(count) * 1e-4
    rows = np.zeros(count, ROW)
    rows["cycle"], rows["periods"], rows["time_ns"] = np.arange(count) + 7, 1, np.arange(count) * 100_000
    axis = rows["axis"]
    axis["reference_um"][:] = 50 * np.sin(2 * np.pi * 5 * t)[:, None] + [1.0, 2.0, 3.0]
    axis["true_stage_um"][:] = axis["reference_um"] + 0.001 * noise.standard_normal((count, 3))
    axis["stage_um"][:] = axis["true_stage_um"] + 0.01 * noise.standard_normal((count, 3))
    axis["innovation_um"][:] = 0.01 * noise.standard_normal((count, 3))
    axis["estimate_um"][:] = axis["stage_um"] - 0.3 * axis["innovation_um"]
    axis["feedforward_V"][:] = 60 + axis["stage_um"] * 0.5
    axis["feedback_V"][:] = noise.standard_normal((count, 3))
    axis["voltage_V"][:] = axis["feedforward_V"] + axis["feedback_V"]
    axis["path_error_um"][:] = axis["reference_um"] - axis["true_stage_um"]
    return rows


def test_blocks_follow_one_another():
    """A codec goes on with the orders it has found; each of its blocks is read alone."""
    rows, codec = motion(3100), BlockCodec.of(ROW)
    blocks = [codec.encode(part) for part in np.split(rows, range(100, 3100, 100))]
    for part, block in reversed(list(zip(np.split(rows, range(100, 3100, 100)), blocks, strict=True))):
        assert read_back(codec, block).tobytes() == part.tobytes()


NESTED = np.dtype([("n", "<i4"), ("list", "<f8", (3,)), ("part", [("a", "<f8"), ("b", "<i4")], (2,))], align=True)


@pytest.mark.parametrize("dtype", [ROW, NESTED])
def test_columns_are_the_record_taken_apart(dtype):
    assert record_of(columns_of_rows(dtype), dtype.itemsize) == dtype


@pytest.mark.parametrize("damage", [lambda b: b[:4], lambda b: b[:-1], lambda b: b + b"x", lambda b: b"\xff" * len(b)])
def test_a_damaged_block_is_told(damage):
    codec = BlockCodec.of(ROW)
    with pytest.raises(ValueError, match="block"):
        codec.decode(damage(codec.encode(motion(50))))
