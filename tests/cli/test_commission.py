"""``commission``: from factory values to a file that `check`, `run` and `evaluate` take, and nothing else touched."""

import io
import json

import pytest

from campaigns.report import CONFIG
from micromanip.design.validate import paper
from micromanip.settings.load import load_with_source
from micromanip.settings.tuning_hash import changes_since

from .command import code_of

pytestmark = pytest.mark.long

FACTORY = CONFIG / "factory.yaml"

GAUGE_ONLY = """\
schema_version: 2
loop: {rate_hz: 10000, cpu: null, limits: simulation}
drivers: {cell: {driver: simulated, axes: [x], seed: 1}}
signals: {strain_x: {driver: cell, range_um: [-30, 150]}}
outputs: {voltage_x: {driver: cell, range_V: [-20, 150], slew_V_per_ms: 10}}
reference: {source: jog, offset_um: 0, range_um: [-15, 100]}
axes: {x: {centre_um: 66, setpoint: {range_um: [2, 128]}}}
"""


def test_it_passes_and_leaves_three_files_and_a_folder_of_the_run(commissioned):
    folder = commissioned.folder
    (run,) = (folder / "out").glob("[0-9]*-y")
    assert (folder / "out" / "latest").resolve() == run
    files = {"tuned.yaml", "previous.yaml", "report.html"}
    assert {file.name for file in run.iterdir()} == files
    assert {file.name for file in (folder / "out").iterdir()} == {*files, "latest", run.name}
    for name in files:
        assert not (folder / "out" / name).is_symlink()
        assert (folder / "out" / name).read_bytes() == (run / name).read_bytes()
    assert (folder / "cell.yaml").read_bytes() == FACTORY.read_bytes()
    assert (folder / "out" / "previous.yaml").read_bytes() == FACTORY.read_bytes()


def test_the_tuned_file_passes_check_without_warning(commissioned, capsys):
    tuned = commissioned.folder / "out" / "tuned.yaml"
    assert code_of("check", tuned, "--json") == 0
    out, err = capsys.readouterr()
    assert json.loads(out)["warnings"] == []
    assert "WARNING" not in err


def test_only_the_named_axis_is_changed_and_comments_stay(commissioned):
    tuned, _ = load_with_source(commissioned.folder / "out" / "tuned.yaml")
    factory, source = load_with_source(FACTORY)
    assert tuned.axes["x"] == factory.axes["x"]
    assert tuned.axes["z"] == factory.axes["z"]
    text = (commissioned.folder / "out" / "tuned.yaml").read_text(encoding="utf-8")
    assert all(line in text for line in source.text.splitlines() if line.strip().startswith("#"))
    y = tuned.axes["y"]
    (run,) = (commissioned.folder / "out").glob("[0-9]*-y")  # whatever is commissioned into the same folder later
    assert commissioned.folder / "out" / y.commissioned.report == run / "report.html"
    assert list(changes_since(tuned.axes)) == []
    assert y.outer is not None
    assert y.hysteresis_affine is not None


def test_evaluate_is_at_or_below_the_papers_sigma(commissioned, capsys, monkeypatch):
    """Only what is judged here is played; all of it: test_evaluate.py."""
    monkeypatch.setattr(paper, "SIGMA_UM", {"C": paper.SIGMA_UM["C"]})
    tuned = commissioned.folder / "out" / "tuned.yaml"
    assert code_of("evaluate", tuned, "--axis", "y", "--json") == 0
    rows = json.loads(capsys.readouterr().out)["rows"]
    judged = [row for row in rows if row["config"] in ("C", "D")]
    assert {(row["config"], row["frequency_hz"]) for row in judged} == {(c, f) for c in "CD" for f in (1.0, 5.0, 10.0)}
    for row in judged:
        assert row["std_error_um"] <= paper.SIGMA_UM["C"][row["frequency_hz"]]


def test_an_axis_with_a_gauge_alone_and_nothing_tuned_gets_its_strain_loop(tmp_path, capsys):
    """No stage sensor, no section `inner`, and a set-point that may be faster than its output."""
    config = tmp_path / "cell.yaml"
    config.write_text(GAUGE_ONLY, encoding="utf-8")
    assert code_of("commission", config, "--axis", "x", "--out", tmp_path / "out", "--json") == 0
    assert json.loads(capsys.readouterr().out)["verdict"] == "PASS"
    tuned, _ = load_with_source(tmp_path / "out" / "tuned.yaml")
    assert (tuned.axes["x"].mode, tuned.axes["x"].outer) == ("strain", None)
    assert tuned.axes["x"].setpoint.slew_um_per_ms < 7.0
    assert (tuned.reference.range_um, tuned.reference.offset_um) == ((2.0, 128.0), 66.0)
    assert code_of("check", tmp_path / "out" / "tuned.yaml") == 0


def test_a_real_stage_moves_only_after_a_yes(tmp_path, capsys, monkeypatch):
    """The simulated driver, declared real: it asks, and without an answer nothing moves."""
    from micromanip_drivers.simulated.driver import SimulatedCell

    config = tmp_path / "cell.yaml"
    text = FACTORY.read_text(encoding="utf-8").replace("limits: simulation", "limits: hardware  ")
    config.write_text(text, encoding="utf-8")
    monkeypatch.setattr(SimulatedCell, "simulated", False)
    monkeypatch.setattr("sys.stdin", io.StringIO(""))
    assert code_of("commission", config, "--axis", "x", "--out", tmp_path / "out") == 130
    assert "Is the spindle free and nobody near it?" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()
