"""``identify``: a recording from the simulation, in virtual time."""

from functools import partial
from unittest.mock import Mock

import numpy as np
import pytest

from campaigns.report import CONFIG
from micromanip.cli.live_experiment import LiveCell
from micromanip.cli.new import text_for
from tests.cells import changed

from . import command

FACTORY = CONFIG / "factory.yaml"
SLOW_BUS = "seed: 1, bus: {input_rate_Hz: 250, input_latency_us: 6000, output_rate_Hz: 250, output_latency_us: 6000}}"
OLDER = "_x: {driver: cell, max_age_us: 30000, range_um: "


code_of = partial(command.code_of, "identify")


def table(file):
    return np.genfromtxt(file, delimiter=",", names=True)


@pytest.mark.parametrize("kind", ["multisine", "turns", "triangle", "step"])
def test_virtual_time(kind, tmp_path, capsys):
    out = tmp_path / "out"
    assert code_of(FACTORY, "--axis", "y", "--kind", kind, "--seconds", "2", "--out", out) == 0
    file = out / f"y_{kind}.csv"
    said = capsys.readouterr().out.splitlines()
    assert said[0].startswith(f"{file}: ")
    assert ", t_s, voltage_V, strain_um, stage_um; stroke " in said[0].replace(" rows,", ",")
    assert said[1] == f"next: micromanip fit hysteresis {file} --input voltage_V --output strain_um --burn-in 1"
    assert [path.name for path in out.iterdir()] == [file.name]
    columns = table(file)
    assert columns.dtype.names == ("t_s", "voltage_V", "strain_um", "stage_um")
    assert len(columns) >= 2000
    np.testing.assert_allclose(np.diff(columns["t_s"]), 1e-3, atol=1e-9)
    assert np.ptp(columns["strain_um"]) > 50.0


def with_stage_range(folder, low_um, high_um):
    """The factory's cell, whose stage sensor of axis x is at an end of its range outside of these."""
    file = folder / "cell.yaml"
    whole = "stage_x: {driver: cell, max_age_us: 300}"
    file.write_text(changed(FACTORY.read_text(), (whole, f"{whole[:-1]}, range_um: [{low_um}, {high_um}]}}")))
    return file


def test_what_a_stage_sensor_held_is_no_value(tmp_path, capsys):
    """It is beyond one end of its range for a while, which no limit forbids in open loop."""
    cell, out = with_stage_range(tmp_path, -200, 400), tmp_path / "out"
    assert code_of(cell, "--axis", "x", "--seconds", "2", "--out", out) == 0
    said = capsys.readouterr()
    assert "warning: signals.stage_x gave no usable sample for " in said.err
    stage_um = table(out / "x_multisine.csv")["stage_um"]
    assert 0.05 < np.isnan(stage_um).mean() < 0.95
    assert np.nanmin(stage_um) > -200.5
    assert np.isfinite(table(out / "x_multisine.csv")["strain_um"]).all()


def test_a_gauge_of_the_wrong_sign_is_told_at_once_and_the_recording_stays(tmp_path, capsys):
    cell, out = tmp_path / "cell.yaml", tmp_path / "out"
    inverted = "faults: [{channel: strain_x, kind: scale, value: -1.0, at_s: 0}]"
    cell.write_text(changed(FACTORY.read_text(), ("    variation: ", f"    {inverted}\n    variation: ")))
    assert code_of(cell, "--axis", "x", "--seconds", "1", "--out", out) == 1
    said = capsys.readouterr()
    assert "axis x: the strain gauge falls while the voltage rises: the wrong way" in said.err
    assert "change the sign of its scale (signals.strain_x), and record again" in said.err
    assert "next: " not in said.out
    assert len(table(out / "x_multisine.csv")) >= 1000


def lag_ms(file):
    """By how much the strain is behind the voltage, to the millisecond of the rows."""
    columns, most = table(file), 40
    voltage, strain = columns["voltage_V"], columns["strain_um"][most:]
    left = [
        np.polyfit(voltage[most - rows : len(voltage) - rows], strain, 3, full=True)[1][0] for rows in range(most + 1)
    ]
    return int(np.argmin(left))


def test_the_ways_of_a_slow_bus_are_not_in_a_recording(tmp_path):
    """Samples and voltages every 4 ms, each 6 ms on its way: 12 ms and more, of which nothing is the plant's."""
    quick = text_for("simulated", ["x"], sensors=["stage"])
    slow = changed(quick, ("seed: 1}", SLOW_BUS), ("_x: {driver: cell, range_um: [-30,", OLDER + "[-30,"),
                   ("_x: {driver: cell, range_um: [-300,", OLDER + "[-300,"))  # fmt: skip
    lags_ms = []
    for name, text in (("quick", quick), ("slow", slow)):
        (tmp_path / f"{name}.yaml").write_text(text)
        assert code_of(tmp_path / f"{name}.yaml", "--axis", "x", "--seconds", "2", "--out", tmp_path / name) == 0
        lags_ms.append(lag_ms(tmp_path / name / "x_multisine.csv"))
    assert abs(lags_ms[1] - lags_ms[0]) <= 2


def test_an_experiment_that_is_cut_short_leaves_no_file(monkeypatch, tmp_path, capsys):
    """The stage rests by then: test_broken_off.py."""
    monkeypatch.setattr(LiveCell, "play", Mock(side_effect=KeyboardInterrupt))
    arguments = ("--axis", "x", "--live", "--socket", tmp_path / "control.sock", "--out", tmp_path / "out")
    assert code_of(FACTORY, *arguments) == 1
    assert "the experiment was cut short. Nothing is written" in " ".join(capsys.readouterr().err.split())
    assert not (tmp_path / "out").exists()
