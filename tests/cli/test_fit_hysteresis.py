"""``fit hysteresis``: the documented keys, the model on held-out data and in the configuration, errors in one line."""

import json
import re
from functools import partial
from pathlib import Path

import numpy as np
import pytest
import yaml

from campaigns.report import CONFIG
from micromanip.settings.load import load_with_source
from micromanip.settings.schema.hysteresis import PrandtlIshlinskii
from tests.design.actuators import predict

from . import command

FACTORY = CONFIG / "factory.yaml"
STEP_S = 2e-3
COLUMNS = ("--input", "u_V", "--output", "y_um", "--burn-in", "1")
QUICK = (*COLUMNS, "--model", "pi-affine", "--plays", "6")
TRUE = PrandtlIshlinskii(
    model="pi",
    shaping="affine",
    coefficients=(0.6, 5.0),
    thresholds_um=(2.0, 4.0, 6.0, 8.0, 10.0, 12.0),
    weights=(0.1, 0.1, 0.1, 0.1, 0.1, 0.1),
    range_um=(-1e4, 1e4),
)


def record(file, seed, step_s=STEP_S):
    """A recording of a known model with 0.05 um of noise."""
    t, rng = np.arange(3000) * step_s, np.random.default_rng(seed)
    u = 60.0 + 30.0 * np.sin(2 * np.pi * 0.7 * t + seed) + 15.0 * np.sin(2 * np.pi * 2.3 * t + 2 * seed)
    y = predict(TRUE, u, step_s) + 0.05 * rng.standard_normal(len(t))
    np.savetxt(file, np.column_stack([t, u, y]), "%.9g", ",", header="t_s,u_V,y_um", comments="")
    return str(file)


code_of = partial(command.code_of, "fit", "hysteresis")


@pytest.fixture
def csv(tmp_path):
    return record(tmp_path / "x.csv", 1)


@pytest.fixture
def cell(tmp_path):
    """A configuration of our own to put models into."""
    file = tmp_path / "cell.yaml"
    file.write_text(FACTORY.read_text())
    return file


def test_json_has_the_documented_keys(csv, capsys):
    assert code_of(csv, *QUICK, "--json") == 0
    report = json.loads(capsys.readouterr().out)
    assert {"model", "rms_percent", "max_percent", "validation", "parameters"} <= set(report)
    assert report["model"] == "pi-affine"
    assert report["validation"] is None
    assert report["page"] is None
    assert 0 < report["rms_percent"] <= 0.1
    assert report["rms_percent"] < report["max_percent"] <= 1.0
    model = PrandtlIshlinskii(**report["parameters"])
    u = 60.0 - 40.0 * np.cos(np.linspace(0.0, 12.0, 2000))
    np.testing.assert_allclose(predict(model, u)[500:], predict(TRUE, u)[500:], atol=0.3)


def test_how_much_of_the_set_points_range_was_seen_is_told(csv, cell, capsys):
    for low, high in ((2, 128), (-20, 128)):
        cell.write_text(cell.read_text().replace("range_um: [2, 128]", f"range_um: [{low}, {high}]"))
        assert code_of(csv, *QUICK, "--into", cell, "--axis", "x") == 0
        told = "% of the set-point's range, -20 to 128 um: beyond, the model is continued" in capsys.readouterr().out
        assert told == (low == -20)


def test_into_keeps_comments_and_the_other_axes(csv, cell, capsys):
    before = cell.read_text()
    assert code_of(csv, *QUICK, "--into", cell, "--axis", "y") == 0
    assert capsys.readouterr().out.endswith(f"written into {cell}\n")
    after = cell.read_text()
    for comment in re.findall(r"# .*", before):
        assert comment in after
    old, new = yaml.safe_load(before), yaml.safe_load(after)
    assert new["axes"]["y"].pop("hysteresis")["model"] == "pi"
    assert new == old
    configuration, _ = load_with_source(cell)
    model = configuration.axes["y"].hysteresis
    assert model.range_um == configuration.axes["y"].setpoint.range_um
    assert len(model.weights) == 6


@pytest.mark.parametrize(
    ("header", "factor", "columns", "says"),
    [
        (
            "t_s,u_V,y_um",
            1e-3,
            COLUMNS,
            "y_um goes from .* um, the set-point of axis x of .* from 2 to 128: too far beyond",
        ),
        (
            "t_s,u,y_um",
            1.0,
            ("--input", "u", "--output", "y"),
            "u states no unit, and --into takes none for granted: write u:V",
        ),
        ("t_s,u_V,y", 1.0, ("--input", "u", "--output", "y"), "y states no unit, .* write y:um"),
        ("t_s,u_V,y_um", 1.0, ("--input", "y", "--output", "u"), "y_um is in um, which is no unit of voltage"),
    ],
)
def test_into_takes_no_unit_for_granted(csv, cell, header, factor, columns, says, capsys):
    """A gauge in mm once put a model into the cell that was continued to 800 times what had been recorded."""
    rows = [line.split(",") for line in Path(csv).read_text().splitlines()[1:]]
    Path(csv).write_text("\n".join([header, *(f"{t},{u},{factor * float(y)}" for t, u, y in rows)]))
    before = cell.read_text()
    assert code_of(csv, *columns, "--model", "pi-affine", "--into", cell, "--axis", "x") == 1
    assert re.search(says, capsys.readouterr().err.replace("\n", " "))
    assert cell.read_text() == before


REFUSED = {
    "--axis alone": (("--axis", "x"), 64, "--into and --axis go together"),
    "no such axis": (("--into", "cell.yaml", "--axis", "w"), 64, "there is no axis 'w' in cell.yaml"),
    "another rate": (("--validate", "other.csv"), 1, "other.csv: sampled every 0.004 s"),
    "no such model": (("--model", "cubic"), 64, "--model"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_what_is_refused_before_anything_is_written(name, csv, cell, tmp_path, monkeypatch, capsys):
    arguments, code, named = REFUSED[name]
    monkeypatch.chdir(tmp_path)
    record("other.csv", 2, 4e-3)
    before = cell.read_bytes()
    quick = QUICK[:6] if "--model" in arguments else QUICK
    assert code_of(csv, *quick, "--out", "out", *arguments) == code
    assert named in capsys.readouterr().err
    assert cell.read_bytes() == before
    assert not Path("out").exists()
