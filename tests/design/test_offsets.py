"""Nothing that is printed depends on where a sensor has its zero; real recordings where they are there."""

import json
from pathlib import Path

import numpy as np
import pytest

from micromanip.cli.main import main
from micromanip.design.hysteresis import fit, structure_of
from tests.further import further

DATA = Path(__file__).parents[2].parent / "shared" / "data"
SWEPT_LATE_S = 0.2  # the record has not been over its range when the burn-in ends
FURTHER = further(("pi-affine", "model_1hz"), ("rate", "test_amplitudes"))
OFFSETS = [(0.0, 1000.0), (-37.3, 0.0), (0.01, -12.3456), (250.0, 0.7)]


def table(name):
    file = DATA / name
    if not file.is_file():
        pytest.skip(f"the real recordings are not here: {name} is not beside the project")
    if file.suffix == ".csv":
        return np.loadtxt(file, delimiter=",", skiprows=1)[:, :3]
    return np.loadtxt(file)


def figures_of(capsys, *arguments):
    """All that is printed as a figure: errors, without the parameters, which contain the offset."""
    main(["fit", *map(str, arguments), "--json"])
    report = json.loads(capsys.readouterr().out)
    names = (
        "rms_percent",
        "rms_std_percent",
        "max_percent",
        "fit_percent",
        "strict_fit_percent",
        "poles_Hz",
        "coherence",
    )
    shown = [report[name] for name in (*names, "arx1_strict_fit_percent") if name in report]
    shown += [[c["rms_percent"], c["held_out_percent"]] for c in report.get("candidates", [])]
    shown += list((report["validation"] or {}).values()) + list(report.get("tried", {}).values())
    return np.concatenate([np.ravel(np.array(each, dtype=float)) for each in shown])


def moved(file, columns, du, dy):
    """The record with constants added to input and output, as a file of doubles."""
    with_time = columns.copy()
    with_time[:, -2] += du
    with_time[:, -1] += dy
    np.save(file, with_time)
    return file


@pytest.mark.long
@pytest.mark.parametrize(("kind", "name"), [("pi-affine", "test_amplitudes"), ("rate", "model_1hz"), *FURTHER])
def test_hysteresis_figures(name, kind, tmp_path, capsys):
    own, other = (table(f"yan9a_piezo/{each}.csv") for each in (name, "model_1hz"))
    found = []
    for du, dy in [(0.0, 0.0), *OFFSETS[::2]]:
        files = [moved(tmp_path / f"{k}.npy", each, du, dy) for k, each in enumerate((own, other))]
        options = ("--time", "1", "--input", "2", "--output", "3", "--burn-in", SWEPT_LATE_S, "--plays", 6)
        found.append(figures_of(capsys, "hysteresis", files[0], *options, "--model", kind, "--validate", files[1]))
    for shifted in found[1:]:
        np.testing.assert_allclose(shifted, found[0], rtol=1e-6)


@pytest.mark.long
@pytest.mark.parametrize("name", ["daisy/robot_arm.dat", "daisy/dryer.dat", *further("yan9a_piezo/model_1hz.csv")])
def test_linear_figures(name, tmp_path, capsys):
    columns = table(name)
    count = columns.shape[1]
    options = ("--input", count - 1, "--output", count, *(("--dt", 1) if count == 2 else ("--time", "1")))
    found = [
        figures_of(capsys, "linear", moved(tmp_path / "x.npy", columns, du, dy), *options)
        for du, dy in [(0.0, 0.0), *OFFSETS]
    ]
    for shifted in found[1:]:
        np.testing.assert_allclose(shifted, found[0], rtol=1e-6)


def test_the_model_is_the_same_but_for_its_offset():
    t = 0.005 * np.arange(1200)
    v = 50.0 + 30.0 * np.sin(2 * np.pi * 0.9 * t) * (1.0 + 0.2 * np.sin(2.0 * t))
    y = 0.8 * v + 5.0 * np.sin(2 * np.pi * 0.9 * t - 0.6)
    plain = fit(structure_of("pi-tanh", v, 0.005, 5), v, y, (-1e4, 1e4), 50, starts=3)
    other = fit(structure_of("pi-tanh", v, 0.005, 5), v, y + 400.0, (-1e4, 1e4), 50, starts=3)
    assert other.model.weights == pytest.approx(plain.model.weights, rel=1e-9)
    np.testing.assert_allclose(other.predict(v), plain.predict(v) + 400.0, rtol=0, atol=1e-6)
