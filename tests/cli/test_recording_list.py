"""``micromanip recording list``: what the heads say, the order, and files that nobody can read."""

import json
import os

import pytest

from tests.design.test_run_figures import recording

from .command import code_of


@pytest.fixture
def folder(tmp_path):
    recording(tmp_path / "whole.mcap", marks=["coolant [off]"])
    content = (tmp_path / "whole.mcap").read_bytes()
    (tmp_path / "cut.MCAP").write_bytes(content[: len(content) // 2])
    (tmp_path / "empty.mcap").write_bytes(b"")
    os.utime(tmp_path / "empty.mcap", (0, 1_000_000_000))
    (tmp_path / ".hidden.mcap").write_bytes(content)
    (tmp_path / "notes.txt").write_text("of somebody")
    (tmp_path / "gone.mcap").symlink_to(tmp_path / "nowhere")
    return tmp_path


def test_each_recording_is_a_row_the_newest_first(folder, capsys):
    assert code_of("recording", "list", folder, "--json") == 0
    rows = json.loads(capsys.readouterr().out)["recordings"]
    names = [row["name"] for row in rows if row["name"] != "gone.mcap"]  # a link is as old as it is made
    assert names == ["whole.mcap", "cut.MCAP", "empty.mcap"]
    found = {row["name"]: row for row in rows}
    assert found.keys() == {"whole.mcap", "cut.MCAP", "empty.mcap", "gone.mcap"}
    whole, cut = found["whole.mcap"], found["cut.MCAP"]
    assert (whole["axes"], whole["ended"], whole["problem"]) == (["x", "y"], "in order", None)
    assert (whole["marks"], cut["began"]) == (["coolant [off]"], whole["began"])
    assert whole["seconds"] == pytest.approx(2.0)
    assert whole["bytes"] == (folder / "whole.mcap").stat().st_size
    assert 0.5 < cut["seconds"] < 1.5
    assert cut["ended"] == "broken off, or still being written"
    assert found["empty.mcap"]["began"] == "2001-09-09T01:46:40+00:00"
    assert found["empty.mcap"]["problem"].startswith("no recording of ours")
    assert found["gone.mcap"]["problem"] == "no such file"
