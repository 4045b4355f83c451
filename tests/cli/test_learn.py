"""`micromanip learn`: from recordings to a memory, looked at, exported and forgotten; parts tried in virtual time."""

import csv
import json
from functools import partial

import numpy as np
import pytest
from click.testing import CliRunner
from design.learning.played import CONFIG, SECONDS, recording

import micromanip.recordings
from micromanip.cli import learn
from micromanip.cli.learn import command
from micromanip.design.learning import learner
from micromanip.design.learning.parts import Cell
from micromanip.design.learning.transfer import Transfer
from micromanip.errors import CheckFailed, UsageError
from micromanip.settings.check import prepare

pytestmark = pytest.mark.long


@pytest.fixture(scope="module")
def recordings():
    """Two parts by the names of their files, and when they begin."""
    prepared = prepare(CONFIG)
    cell = Cell(prepared, SECONDS, 5.0)
    made = {name: cell.make(seed, {}) for name, seed in (("one.mcap", 1), ("two.mcap", 2))}
    begin_s = made["one.mcap"][1]
    return {name: recording(prepared, rows, name) for name, (rows, _) in made.items()}, begin_s


@pytest.fixture(autouse=True)
def _opened(recordings, monkeypatch):
    monkeypatch.setattr(micromanip.recordings, "open_telemetry", lambda file: recordings[0][file.name])
    monkeypatch.setattr(learner, "Transfer", partial(Transfer, draws=4))


def asked(*arguments):
    return CliRunner().invoke(command, [str(each) for each in arguments])


def document(*arguments):
    result = asked(*arguments, "--json")
    assert result.exit_code == 0, result.exception
    return json.loads(result.stdout)


def test_from_two_recordings_to_a_correction_and_back_to_nothing(recordings, tmp_path):
    memory, begin_s = tmp_path / "learned", recordings[1]
    first = ("--memory", memory, "--axis", "y", "--begin", begin_s, "--seconds", SECONDS)
    told = document("update", "one.mcap", "two.mcap", *first)["updates"]
    assert [(each["file"], each["axis"], each["parts"]) for each in told] == [
        ("one.mcap", "y", 1),
        ("two.mcap", "y", 2),
    ]
    assert told[0]["verdict"] == "first"
    assert {each["missed_percent"] for each in told} == {0.0}
    assert all(0.0 <= each["contraction"] < 1.0 for each in told)
    again = asked("update", "two.mcap", "--memory", memory, "--axis", "y")
    assert str(again.exception) == "two.mcap: axis y has learned from this part already"
    assert (again.exception.exit_code, again.stdout) == (1, "")

    (axis,) = document("status", "--memory", memory)["axes"]
    assert (axis["axis"], axis["parts"], axis["generation"], axis["seconds"]) == ("y", 2, 2, SECONDS)
    assert [part["file"] for part in axis["story"]] == ["one.mcap", "two.mcap"]
    assert "y" in asked("status", "--memory", memory).stdout

    file = tmp_path / "y.csv"
    rows = document("export", "--memory", memory, "--axis", "y", "--to", file)["rows"]
    with file.open(newline="", encoding="utf-8") as opened:
        columns = list(csv.reader(opened))
    assert columns[0] == ["t_s", "path_um", "error_um", "correction_um"]
    values = np.array(columns[1:], dtype=float)
    assert len(values) == rows == round(1000 * SECONDS)
    assert np.abs(values[:, 3]).max() == pytest.approx(axis["correction_um"], rel=1e-5)
    kept = asked("export", "--memory", memory, "--axis", "y", "--to", file)
    assert isinstance(kept.exception, UsageError)

    assert document("reset", "--memory", memory)["removed"] == [str(memory / "y.npz")]
    assert document("status", "--memory", memory)["axes"] == []


def test_what_can_not_be_done_is_told_in_one_sentence_and_leaves_nothing(recordings, tmp_path):
    memory = tmp_path / "learned"
    begun = ("--begin", recordings[1], "--seconds", SECONDS)
    for arguments, kind, message in (
        (
            ("update", "one.mcap", "--memory", memory, "--axis", "q", *begun),
            UsageError,
            "there is no axis q in one.mcap",
        ),
        (("update", "one.mcap", "--memory", memory, "--axis", "y"), CheckFailed, "there is no memory of axis y yet"),
        (("update", "one.mcap", "--memory", "/dev/null/learned", *begun), UsageError, "--memory /dev/null/learned: "),
        (("status", "--memory", memory), CheckFailed, "no such folder"),
        (("export", "--memory", memory, "--axis", "y", "--to", tmp_path / "y.csv"), CheckFailed, "no such memory"),
    ):
        result = asked(*arguments)
        assert isinstance(result.exception, kind), result.exception
        assert message in str(result.exception)
    assert not memory.exists()
    assert not (tmp_path / "y.csv").exists()
    gone = asked("reset", "--memory", memory, "--axis", "y")
    assert gone.exception.exit_code
    assert "y.npz" in str(gone.exception)


def test_a_damaged_memory_is_told_and_can_be_removed(tmp_path):
    file = tmp_path / "y.npz"
    file.write_bytes(b"PK\x03\x04 and no more")
    for arguments in (("status",), ("update", "one.mcap", "--axis", "y")):
        result = asked(*arguments, "--memory", tmp_path)
        assert "or a damaged one" in str(result.exception)
        assert "\n" not in str(result.exception)
    assert "reset --axis y" in str(asked("reset", "--memory", tmp_path).exception)
    assert file.exists()
    assert asked("reset", "--memory", tmp_path, "--axis", "y").exit_code == 0
    assert not file.exists()


def test_what_is_no_memory_is_never_removed(tmp_path):
    file = tmp_path / "y.npz"
    np.savez(file, measured=np.arange(3.0))
    for arguments in ((), ("--axis", "y"), ("--axis", f"../{tmp_path.name}/y")):
        assert asked("reset", "--memory", tmp_path, *arguments).exception
    assert np.load(file)["measured"].tolist() == [0.0, 1.0, 2.0]


def test_parts_in_virtual_time_take_off_what_repeats():
    found = document("try", CONFIG, "--parts", 3, "--seconds", 3)["axes"]
    assert [axis["axis"] for axis in found] == ["x", "y", "z"]
    for axis in found[1:]:  # x has little that repeats
        first, last = axis["parts"][0], axis["parts"][-1]
        assert first["repeats_um"] > 0.04
        assert last["repeats_um"] < 0.4 * first["repeats_um"]
        assert last["whole_um"] == pytest.approx(np.hypot(last["repeats_um"], last["floor_um"]), rel=0.03)
        assert axis["uncompensated_um"] > 100.0 * last["whole_um"]
        assert last["over_floor"] < 1.05
        assert axis["parts"][-1]["learned_Hz"]


def test_the_running_cell_is_asked_where_no_folder_is_named(monkeypatch):
    asked_for = []

    class Running:
        def __init__(self, _):
            pass

        def __enter__(self):
            return self

        def __exit__(self, *_):
            pass

        def learn_status(self):
            last = {"error_um": 0.41, "without_um": 0.52, "verdict": "better", "learned_Hz": [[7.0, 9.0]]}
            axes = {
                "x": {"generation": 4, "may_play": True, "state": "plays", "part": 5, "apart_um": 1.25, "last": last},
                "y": {"generation": 2, "may_play": False, "state": "idle", "part": 5, "apart_um": 0.0, "last": None},
            }
            return {"state": "learning", "made": 4, "folder": "learned", "axes": axes}

        def learn_reset(self, *axes):
            asked_for.append(axes)

    monkeypatch.setattr(learn, "Client", Running)
    monkeypatch.setenv("COLUMNS", "120")
    shown = asked("status").stdout
    for part in ("learning, 4 parts made", "state 4", "plays", "0.520", "better", "7-9", "state 2, not played"):
        assert part in shown
    assert document("status")["axes"]["x"]["last"]["verdict"] == "better"
    assert document("reset", "--axis", "y") == {"accepted": True}
    assert "forgotten" in asked("reset").stdout
    assert asked_for == [("y",), ()]
