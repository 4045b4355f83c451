"""`micromanip analyse error`: its document, and what it says of what it can't budget."""

import json
from pathlib import Path

import pytest
from click.testing import CliRunner

from campaigns.report import CONFIG
from micromanip.cli.analyse_error import command
from micromanip.errors import CheckFailed, UsageError


def asked(*arguments):
    return CliRunner().invoke(command, [str(each) for each in arguments], catch_exceptions=False)


@pytest.mark.long
def test_the_document_sums_to_the_whole_and_a_page_is_written(tmp_path):
    result = asked(CONFIG / "simulated.yaml", "--axis", "x", "--seconds", "4", "--out", tmp_path, "--json")
    (axis,) = json.loads(result.stdout)["axes"]
    assert sum(cause["variance_um2"] for cause in axis["causes"]) == pytest.approx(axis["variance_um2"])
    assert sum(cause["share_percent"] for cause in axis["causes"]) == pytest.approx(100.0)
    assert axis["seen"].startswith("3.0 s of tracking")
    assert axis["bound"]["ratio"] == pytest.approx(axis["rms_um"] / axis["bound"]["rms_um"])
    assert {file.name for file in tmp_path.iterdir()} == {"error.html"}


def test_what_can_not_be_budgeted_is_told():
    with pytest.raises(UsageError, match=r"there is no axis 'q' in .*; there are x, y, z"):
        asked(CONFIG / "simulated.yaml", "--axis", "q")
    with pytest.raises(CheckFailed, match=r"what ran followed no tracker \(reference\.source"):
        asked(CONFIG / "factory.yaml")
    with pytest.raises(CheckFailed, match="no recording of ours"):
        asked(Path(__file__))
    with pytest.raises(CheckFailed, match="axis x: its stage is measured every 10 cycles"):
        asked(CONFIG / "simulated_1khz.yaml")
