"""Files of some minutes each: no row is missing between them, and the oldest go."""

import numpy as np
import pytest

from micromanip.host.recording.mcap_file import McapRecording
from micromanip.recordings import open_telemetry
from micromanip.rt.records import CELL_STATE

from .test_mcap_recording import PERIOD_NS, all_rows, slots, some_rows


def begun(folder, quota_bytes=10**9, rows=1000):
    orders = {"file": str(folder / "shift.mcap"), "configuration": "c", "sha256": "abc", "axes": ["x"]}
    orders |= {"period_ns": PERIOD_NS, "segment_s": rows * PERIOD_NS * 1e-9, "quota_bytes": quota_bytes}
    series = McapRecording(orders)
    series.begin(np.zeros(1, CELL_STATE)[0])
    return series


def files(folder):
    return sorted(path.name for path in folder.iterdir())


@pytest.mark.parametrize("step", [137, 500, 2600])
def test_rows_go_on_from_file_to_file(tmp_path, step):
    series, rows = begun(tmp_path), some_rows(1, 2600)
    for first in range(0, 2600, step):
        series.append(rows[first : first + step], slots(1))
    assert series.written == 2600
    series.close()
    assert files(tmp_path) == ["shift-0001.mcap", "shift-0002.mcap", "shift-0003.mcap"]
    parts = [all_rows(tmp_path / name) for name in files(tmp_path)]
    assert [len(part) for part in parts] == [1000, 1000, 600]
    assert np.concatenate(parts).tobytes() == rows.tobytes()
    for name in files(tmp_path):
        telemetry = open_telemetry(tmp_path / name)
        assert telemetry.end["rows"] > 0
        assert [int(each["version"][0]) for each in telemetry.parameters] == [1]
        assert telemetry.configuration == "c"
        assert (telemetry.state is not None) == (name == "shift-0001.mcap")


def test_the_oldest_go(tmp_path):
    """Those of this series; the one that is being written stays, and what lies beside it."""
    (tmp_path / "shift-0000.mcap").write_text("somebody else's")
    series = begun(tmp_path, quota_bytes=700_000)
    for first in range(1, 10_001, 500):
        series.append(some_rows(first, 500), slots(1))
        there = sum((tmp_path / name).stat().st_size for name in files(tmp_path) if name != "shift-0000.mcap")
        newest = (tmp_path / files(tmp_path)[-1]).stat().st_size
        assert there <= 700_000 or there == newest
        assert series.size_bytes == pytest.approx(there, rel=0.05)
    series.close()
    assert files(tmp_path)[0] == "shift-0000.mcap"
    assert files(tmp_path)[-1] == "shift-0010.mcap"
    assert 3 <= len(files(tmp_path)) < 10
    assert series.written == 10_000
