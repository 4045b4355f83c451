"""``analyse``: its verdicts, its document, its figures, and what it says where something is missing or wrong."""

import contextlib
import io
import json

import pytest

from campaigns.report import CONFIG
from micromanip.cli.main import main

from .command import code_of

pytestmark = pytest.mark.long

PAPER_CELL = CONFIG / "paper.yaml"
SIMULATED, FACTORY = str(CONFIG / "simulated.yaml"), str(CONFIG / "factory.yaml")


def run(capsys, *arguments):
    return code_of("analyse", "margins", *arguments), *capsys.readouterr()


def analysed(capsys, *arguments):
    code, out, _ = run(capsys, *arguments, "--json", "--jobs", "1")
    return code, json.loads(out)


@pytest.fixture(scope="module")
def report(tmp_path_factory):
    folder = tmp_path_factory.mktemp("analysis")

    out = io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.suppress(SystemExit):
        main(
            ["analyse", "margins", SIMULATED, "--axis", "y", "--out", str(folder), "--samples", "2", "--seed", "3",
             "--jobs", "1", "--json"]
        )  # fmt: skip
    return json.loads(out.getvalue())


def test_verdicts_follow_from_the_figures(report):
    (axis,) = report["axes"]
    passed = {criterion["name"]: criterion["passed"] for criterion in axis["criteria"]}
    stage, strain = axis["stage"]["margins"], axis["strain"]["margins"]
    assert passed["outer loop: gain margin"] == (stage["gain_dB"] >= 6.0)
    assert passed["outer loop: phase margin"] == (stage["phase_deg"] >= 35.0)
    assert passed["strain loop: phase margin"] == all(m["phase_deg"] >= 35.0 for m in strain)
    assert passed["strain loop: stable"] == all(m["radius"] < 1.0 for m in strain)
    kept = sum(s["stage"]["stable"] and s["stage"]["sensitivity"] <= 3.0 for s in axis["samples"])
    assert passed["outer loop: drawn plants"] == (kept >= 0.9 * len(axis["samples"]))
    assert passed["outer loop: limit cycle"] == (axis["stage"]["limit_cycles"] == [])
    assert len(strain) == len(axis["strain"]["slopes"]) >= 3
    assert min(axis["strain"]["slopes"]) < 1.0 < max(axis["strain"]["slopes"])


def test_an_untuned_cell_is_told_what_it_lacks(capsys):
    code, out, err = run(capsys, FACTORY, "--axis", "x", "--samples", "0", "--jobs", "1")
    assert "axis x: no describing function: the hysteresis model is none" in out
    assert "axis x: no margins of the outer loop" in out
    assert "strain loop" in out
    assert code == 1
    assert "strain loop: phase margin" in err, "the anchor PID has little phase margin at the flexure's mode"


def test_too_much_gain_fails(capsys, tmp_path):
    text = PAPER_CELL.read_text(encoding="utf-8")
    file = tmp_path / "hot.yaml"
    file.write_text(text.replace("control_weight: 10.0", "control_weight: 0.01"), encoding="utf-8")
    code, report = analysed(capsys, str(file), "--axis", "y", "--samples", "0")
    assert code == 1
    failed = {c["name"] for c in report["axes"][0]["criteria"] if not c["passed"]}
    assert "outer loop: gain margin" in failed
