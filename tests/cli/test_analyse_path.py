"""`micromanip analyse path`: verdict and exit code, its document and page; what it can't take."""

import json

import numpy as np
import pytest
from click.testing import CliRunner

from campaigns.report import CONFIG
from micromanip.cli.analyse_path import command
from micromanip.errors import CheckFailed, UsageError

SIMULATED = CONFIG / "simulated.yaml"


def path_file(folder, amplitude_um):
    time_s = np.arange(0.0, 3.0, 0.004)
    begun = np.clip(time_s / 0.5, 0.0, 1.0) ** 2
    columns = [amplitude_um * begun * np.sin(2.0 * np.pi * 0.5 * time_s), 20.0 * begun, 0.0 * begun]
    file = folder / "path.csv"
    header = "t_s,deviation_x_um,deviation_y_um,deviation_z_um"
    np.savetxt(file, np.column_stack([time_s, *columns]), delimiter=",", header=header, comments="", fmt="%.6f")
    return file


def asked(*arguments):
    return CliRunner().invoke(command, [str(each) for each in arguments])


def test_a_path_that_fits_ends_with_0_and_is_drawn(tmp_path):
    out = tmp_path / "out"
    file = path_file(tmp_path, 150.0)
    result = asked(file, "--config", SIMULATED, "--axis", "x", "--out", out, "--json")
    assert result.exit_code == 0
    found = json.loads(result.stdout)
    (axis,) = found["axes"]
    assert (found["fits"], axis["axis"], axis["stretches"]) == (True, "x", [])
    assert axis["deviation_um"] == pytest.approx([-150.0, 150.0], rel=0.01)
    assert axis["setpoint_um"] == pytest.approx([36.0, 96.0], abs=1.0)
    assert found["page"] == str(out / "path.html")


def test_a_path_that_does_not_fit_ends_with_1_and_says_where(tmp_path):
    result = asked(path_file(tmp_path, 330.0), "--config", SIMULATED)
    assert isinstance(result.exception, CheckFailed)
    assert "does not fit" in str(result.exception)
    assert "axis x, tracker range, at 0.4" in str(result.exception)
    assert "More than there is" in result.stdout


def test_what_can_not_be_previewed_is_told(tmp_path):
    file = path_file(tmp_path, 10.0)
    for arguments, kind, message in (
        ((file, "--config", SIMULATED, "--axis", "q"), UsageError, "there is no axis 'q'"),
        ((file, "--config", SIMULATED, "--reserve", "70"), CheckFailed, "a reserve of 70 um leaves nothing"),
        ((tmp_path / "gone.csv", "--config", SIMULATED), CheckFailed, "no such file"),
        ((SIMULATED, "--config", SIMULATED), CheckFailed, "simulated.yaml"),
    ):
        result = asked(*arguments)
        assert isinstance(result.exception, kind), result.exception
        assert message in str(result.exception)
        assert result.exception.exit_code == (64 if kind is UsageError else 1)
    assert file.read_text(encoding="utf-8").startswith("t_s,")
