"""The past of the scope against numpy on all rows: no peak is lost, memory is fixed, gaps are told."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from micromanip.gateway.cell import Source
from micromanip.gateway.fields import fields
from micromanip.gateway.history import History

from .rings import AXES, TOLD, Played, rows

FIELDS = fields(AXES)
STRAIN = ["x.strain_um"]
FULL, BLOCKS = 512, ((4, 128), (16, 256))


def filled(values, cycles, sizes):
    history = History(FIELDS, FULL, BLOCKS)
    history.take()
    at = 0
    for size in sizes:
        history.add(rows(cycles[at : at + size], x_strain_um=values[at : at + size]))
        at += size
    history.add(rows(cycles[at : at + FULL], x_strain_um=values[at : at + FULL]))
    return history


@st.composite
def pasts(draw):
    n = draw(st.integers(1, 1500))
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    values = rng.normal(size=n).astype(np.float32)
    values[rng.random(n) < draw(st.sampled_from([0.0, 0.1]))] = np.nan
    steps = np.ones(n, np.int64)
    steps[rng.random(n) < draw(st.sampled_from([0.0, 0.05]))] += rng.integers(1, 40)
    sizes = []
    while sum(sizes) < max(0, n - FULL):
        sizes.append(draw(st.integers(1, 300)))
    return values, np.cumsum(steps) + draw(st.integers(0, 1000)), sizes


@given(pasts(), st.floats(0.0, 1.0), st.floats(0.0, 1.0), st.integers(1, 200))
def test_no_peak_of_a_window_is_lost_and_none_is_made_up(past, begin, end, points):
    values, cycles, sizes = past
    history = filled(values, cycles, sizes)
    begin, end = sorted((begin, end))
    first, last = (int(cycles[0] + share * (cycles[-1] - cycles[0])) for share in (begin, end))
    found = history.window(history.index(STRAIN), first, last, points)
    assert len(found.cycles) <= points + 2
    assert (np.diff(found.cycles) > 0).all()
    assert found.cycles[-1] <= last if len(found.cycles) else True
    edges = [*np.searchsorted(cycles, found.cycles), None]
    for k, (low, high) in enumerate(zip(found.low[0], found.high[0], strict=True)):
        stop = edges[k + 1] if edges[k + 1] is not None else min(edges[k] + found.rows, len(values))
        held = values[edges[k] : stop]
        if edges[k + 1] is None:  # the newest block may not be whole yet
            assert np.isnan(low) or np.nanmin(held) <= low <= high <= np.nanmax(held)
        elif np.isnan(held).all():
            assert np.isnan(low)
            assert np.isnan(high)
        else:
            assert (low, high) == (np.nanmin(held), np.nanmax(held))


def test_a_window_of_few_cycles_is_whole_and_one_of_the_far_past_is_blocks():
    cycles = np.arange(3000)
    history = filled(np.sin(cycles), cycles, [100] * 25)
    near = history.window(history.index(STRAIN), 2900, 2950, 100)
    assert near.rows == 1
    assert near.cycles.tolist() == list(range(2900, 2951))
    np.testing.assert_array_equal(near.low[0], np.sin(near.cycles).astype(np.float32))
    far = history.window(history.index(STRAIN), 200, 400, 1000)
    assert far.rows == 16, "only the coarsest level reaches back so far"
    assert far.cycles[0] <= 200 < far.cycles[1]
    assert history.oldest_full == 3000 - FULL


def test_a_ring_is_read_without_gaps_and_what_was_overwritten_is_counted(tmp_path):
    played = Played(tmp_path)
    played.play(rows(np.arange(50_000)))
    played.read()
    source = played.cell.source
    before = source.history.count
    assert before == 1 << 15, "what was there before is seen as well, as far as it will not be overwritten soon"
    for begin in range(50_000, 99_000, 7_000):
        played.play(rows(np.arange(begin, begin + 7_000)))
        played.read()
    end = source.history.newest
    cycles, _ = source.history.whole([0], 0, end)
    assert (np.diff(cycles) == 1).all()
    assert source.reader.lost == 0
    size = len(played.ring["rows"])
    played.play(rows(np.arange(end + 1, end + 1 + 60_000)))
    played.play(rows(np.arange(end + 60_001, end + 80_001)))
    played.read()
    assert source.reader.lost == 80_000 - size + 1
    assert source.history.newest == end + 80_000
    assert source.history.count + source.reader.lost == end + 80_001 - (50_000 - before)


def test_the_next_controller_begins_anew_in_the_same_memory(tmp_path):
    played = Played(tmp_path / "control.sock")
    played.play(rows(np.arange(5000), x_strain_um=1.0))
    played.read()
    before = played.cell.source
    following = Played(tmp_path / "control.sock")
    source = Source(TOLD, following.status, following.ring, following.control, 2, before.history)
    following.cell.source = source
    following.play(rows(np.arange(100, 2100), x_strain_um=2.0))
    following.read()
    assert source.history is before.history
    assert (source.history.count, source.history.oldest, source.history.newest) == (2000, 100, 2099)
    window = source.history.window(source.history.index(["x.strain_um"]), 0, 10_000, 10)
    assert set(window.low.ravel()) == set(window.high.ravel()) == {2.0}
