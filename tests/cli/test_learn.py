"""``learn``: parts are told to the running cell; memories are shown, exported and forgotten, and nothing else is."""

import json

import numpy as np
import pytest

from micromanip.cli import learn

from .command import code_of
from .played import Played


def asked(capsys, *arguments, code=0):
    """Standard output, and standard error."""
    assert code_of("learn", *arguments) == code
    return capsys.readouterr()


@pytest.mark.parametrize("what", ["begin", "end"])
def test_a_part_is_told(what, tmp_path, capsys):
    controller = Played(tmp_path / "control.sock")
    try:
        tool = ("--tool", "3") if what == "begin" else ()
        out, _ = asked(capsys, "part", what, *tool, "--socket", controller.path, "--json")
        assert json.loads(out) == {"accepted": True, "part": what}
        assert controller.orders == [f"part_{what}"]
    finally:
        controller.close()


def test_a_tool_goes_with_the_beginning(capsys):
    assert "--tool" in asked(capsys, "part", "end", "--tool", "3", code=64).err


@pytest.mark.parametrize(
    "arguments", [("status",), ("export", "--axis", "y", "--to", "y.csv"), ("reset", "--axis", "y")]
)
def test_what_is_not_there_is_told(arguments, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert code_of("learn", *arguments, "--memory", "none") != 0
    assert "none" in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


def test_a_damaged_memory_is_told_and_can_be_removed(tmp_path, capsys):
    file = tmp_path / "y.npz"
    file.write_bytes(b"PK\x03\x04 and no more")
    for arguments in (("status",), ("export", "--axis", "y", "--to", tmp_path / "y.csv"), ("reset",)):
        assert "or a damaged one" in asked(capsys, *arguments, "--memory", tmp_path, code=1).err
    assert file.exists()
    asked(capsys, "reset", "--memory", tmp_path, "--axis", "y")
    assert not file.exists()


def test_what_is_no_memory_is_never_removed(tmp_path):
    file = tmp_path / "y.npz"
    np.savez(file, measured=np.arange(3.0))
    for arguments in ((), ("--axis", "y"), ("--axis", f"../{tmp_path.name}/y")):
        assert code_of("learn", "reset", "--memory", tmp_path, *arguments) != 0
    assert np.load(file)["measured"].tolist() == [0.0, 1.0, 2.0]


def test_the_running_cell_is_asked_where_no_folder_is_named(monkeypatch, capsys):
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
    shown = asked(capsys, "status").out
    for part in ("learning, 4 parts made", "state 4", "plays", "0.520", "better", "7-9", "state 2, not played"):
        assert part in shown
    assert json.loads(asked(capsys, "status", "--json").out)["axes"]["x"]["last"]["verdict"] == "better"
    assert json.loads(asked(capsys, "reset", "--axis", "y", "--json").out) == {"accepted": True}
    assert "forgotten" in asked(capsys, "reset").out
    assert asked_for == [("y",), ()]
