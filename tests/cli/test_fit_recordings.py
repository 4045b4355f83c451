"""`fit` on recordings as people have them: options, what is told, exit codes, spikes that decide nothing."""

import json

import numpy as np
import pytest

from .test_fit_linear import code_of as linear_code
from .test_fit_linear import record as linear_record


def test_a_linear_fit_with_a_gap_and_spikes_is_that_without(tmp_path, capsys):
    file = linear_record(tmp_path / "x.csv")
    table = np.loadtxt(file, delimiter=",", skiprows=1)
    table[[50, 700, 1500], 3] += 200.0
    table = np.delete(table, [400, 401], axis=0)
    np.savetxt(tmp_path / "g.csv", table, "%.12g", ",", header="t_s,u1,u2,y1,y2", comments="")
    names = ("--input", "u1,u2", "--output", "y1,y2", "--json")
    reports = []
    for each in (file, tmp_path / "g.csv"):
        assert linear_code(each, *names) == 0
        shown = capsys.readouterr()
        reports.append(json.loads(shown.out))
    assert reports[1]["order"] == reports[0]["order"] == 3
    assert reports[1]["fit_percent"] == pytest.approx(reports[0]["fit_percent"], abs=1.0)
    assert reports[0]["strict_fit_percent"] == pytest.approx(reports[0]["fit_percent"], abs=0.5)
    assert reports[0]["arx1_strict_fit_percent"][0] < 50.0
    assert "2 samples are missing before" in shown.err
    assert "y1: 3 samples stand out as spikes" in shown.err
