"""A recording as the scope's past against all of its rows: no peak is lost, faults and remarks are found."""

import re

import numpy as np
import pytest
from mcap.reader import make_reader
from recordings.damaged import damage

from micromanip.gateway.viewing import RecordedSource
from micromanip.host.recording.mcap_file import McapRecording
from micromanip.recordings import open_telemetry
from micromanip.rt import states
from micromanip.rt.records import CELL_PARAMETERS

from .rings import AXES, rows

COUNT, FAULT_CYCLE, MARK_CYCLE = 7_300, 6_001, 4_000
NAMES = ["x.strain_um", "y.strain_um", "state"]


def made():
    cycles = np.r_[np.arange(100, 3000), np.arange(3050, 3050 + COUNT - 2900)]
    found = rows(cycles, x_strain_um=np.random.default_rng(1).normal(size=COUNT).astype(np.float32))
    found["axis"]["strain_um"][:, 1] = np.nan
    late = found["cycle"] >= FAULT_CYCLE
    found["state"][late], found["fault"][late] = states.FAULT, states.STRAIN_INVALID
    return found


def written(file):
    orders = {"file": str(file), "axes": AXES, "period_ns": 100_000, "configuration": "", "sha256": "0" * 64}
    recording = McapRecording(orders)
    recording.mark("coolant on", MARK_CYCLE, "ana", MARK_CYCLE * 100_000)
    for part in np.array_split(made(), 9):
        recording.append(part, np.zeros(1, CELL_PARAMETERS))
    recording.close()
    return file


def opened(file):
    """With its overview beside it."""
    return RecordedSource(open_telemetry(file), file.parent)


@pytest.fixture(scope="module")
def source(tmp_path_factory):
    file = written(tmp_path_factory.mktemp("history") / "run.mcap")
    found = opened(file)
    assert found.recording["rows"] == COUNT
    assert found.history.overview.share == 0.0
    found.history.overview.fill()
    assert found.history.overview.share == 1.0
    return found


@pytest.mark.parametrize(
    ("first", "last", "points"), [(0, 9000, 50), (0, 9000, 3), (2900, 3200, 5000), (101, 7000, 700)]
)
def test_a_window_of_a_file_has_the_least_and_greatest_of_its_rows(source, first, last, points):
    every, history = made(), source.history
    window = history.window(history.index(NAMES), first, last, points)
    assert 0 < len(window.cycles) <= points + 2
    edges = [*np.searchsorted(every["cycle"], window.cycles), None]
    for k in range(len(window.cycles)):
        stop = edges[k + 1] if edges[k + 1] is not None else min(edges[k] + window.rows, COUNT)
        if edges[k + 1] is None and window.rows < 16:  # a point of rows ends where the window does
            stop = min(stop, np.searchsorted(every["cycle"], last + 1))
        held = every["axis"]["strain_um"][edges[k] : stop, 0]
        assert (window.low[0, k], window.high[0, k]) == (held.min(), held.max())
    assert np.isnan(window.low[1]).all()
    if first == 0:
        assert window.cycles[0] == 100
        assert every["cycle"][-1] - window.cycles[-1] < window.rows


def test_rows_are_found_by_their_cycle_whatever_was_read_before(source):
    every, history = made(), source.history
    for first, last in ((3000, 3049), (2990, 3060), (5000, 5001), (100, 100), (7449, 9999)):
        cycles, (strain,) = history.whole(history.index(NAMES[:1]), first, last)
        wanted = every[(every["cycle"] >= first) & (every["cycle"] <= last)]
        assert cycles.tolist() == wanted["cycle"].tolist()
        assert strain.tolist() == wanted["axis"]["strain_um"][:, 0].tolist()


def test_faults_and_remarks_are_marked_at_their_cycle(source):
    wanted = [(MARK_CYCLE, "mark", "coolant on (ana)"), (FAULT_CYCLE, "fault", "X-201 STRAIN_INVALID")]
    assert source.so_far() == {"known": 1.0, "marks": wanted}
    assert (source.recording["first"], source.recording["last"]) == (100, 3050 + COUNT - 2901)


def test_what_was_cut_off_is_shown_up_to_there_and_said(tmp_path):
    file = written(tmp_path / "run.mcap")
    with file.open("rb") as stream:
        chunks = make_reader(stream).get_summary().chunk_indexes
    assert len(chunks) > 1
    file.write_bytes(file.read_bytes()[: chunks[-1].chunk_start_offset + chunks[-1].chunk_length // 2])
    found = opened(file)
    assert 0 < found.recording["rows"] < COUNT
    assert "this is what was in the file" in found.recording["problem"]


@pytest.mark.parametrize("place", [0.3, 0.7])
def test_a_damaged_piece_is_left_blank_and_said(tmp_path, place):
    file, every = written(tmp_path / "run.mcap"), made()
    damage(file, place)
    source = opened(file)
    source.history.overview.fill()
    assert source.history.overview.share == 1.0
    ((first, _, text),) = [mark for mark in source.so_far()["marks"] if mark[1] == "damage"]
    lost = int(re.fullmatch(r"damaged: (\d+) cycles can't be read \(it is damaged.*\)", text)[1])
    assert 0 < lost < 1000
    columns = source.history.index(NAMES[:1])
    cycles, _ = source.history.whole(columns, 0, 20_000)
    kept = every["cycle"][(every["cycle"] < first) | (every["cycle"] >= first + lost)]
    assert cycles.tolist() == kept[kept >= source.history.oldest].tolist()
    window = source.history.window(columns, 0, 20_000, 500)
    assert not [begin for begin in window.cycles if first < begin < first + lost - window.rows]
    assert np.isnan(window.low[:, window.cycles == first]).any(), "no line goes over it"


def test_a_recording_without_its_index_has_the_same_pieces(tmp_path):
    """Ended in order it is read by the index at its end; killed, record by record."""
    file = written(tmp_path / "run.mcap")
    whole = open_telemetry(file)
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(file.read_bytes()[:-1])
    killed = open_telemetry(cut)
    rows = [[piece(["cycle", "axis.0.strain_um"]) for piece in each.pieces()] for each in (whole, killed)]
    assert len(rows[0]) == len(rows[1]) == 9
    for one, other in zip(*rows, strict=True):
        assert one["cycle"].tobytes() == other["cycle"].tobytes()
        assert one["axis.0.strain_um"].tobytes() == other["axis.0.strain_um"].tobytes()
    assert np.concatenate([part["cycle"] for part in rows[0]]).tolist() == made()["cycle"].tolist()
    assert whole.marks == killed.marks
    assert whole.configuration == killed.configuration
    assert whole.end["rows"] == COUNT
