"""``fit linear --into``: the model in the configuration is that of the record, `check` passes, the rest stays."""

from functools import partial
from pathlib import Path

import numpy as np
import pytest
from scipy.signal import cont2discrete

from micromanip.settings.load import load_with_source
from micromanip.settings.schema.axis import LinearModel, Outer

from . import command

FACTORY = Path(__file__).parents[2] / "config" / "factory.yaml"
STAGE = ("--input", "setpoint_um", "--output", "stage_um", "--axis", "x")
OMEGA, DAMPING = 2 * np.pi * 60.0, 0.05
CONTINUOUS = np.array([[0.0, 1.0], [-(OMEGA**2), -2 * DAMPING * OMEGA]]), np.array([[0.0], [OMEGA**2]])
A, B, C, _, _ = cont2discrete((*CONTINUOUS, np.array([[1.0, 0.0]]), np.zeros((1, 1))), 1e-4)
MODE = LinearModel(A=A.tolist(), B=B[:, 0].tolist(), C=C[0].tolist(), delay_cycles=6)
"""At 60 Hz, at 10 kHz."""

code_of = partial(command.code_of, "fit", "linear")


@pytest.fixture
def cell(tmp_path):
    file = tmp_path / "cell.yaml"
    file.write_text(FACTORY.read_text())
    return file


def stage(file, every=1, header="t_s,setpoint_um,stage_um", seconds=4.0, model=MODE):
    """What answers a set-point that is held for `every` cycles, each of which makes a row."""
    A, B, C = (np.array(each) for each in (model.A, model.B, model.C))
    rng = np.random.default_rng(0)
    u = np.repeat(rng.standard_normal(round(seconds * 1e4 / every)), every)
    late = np.concatenate([np.zeros(model.delay_cycles), u])
    x, y = np.zeros(len(A)), np.empty(len(u))
    for k in range(len(u)):
        y[k] = C @ x
        x = A @ x + B * late[k]
    y += 1e-3 * y.std() * rng.standard_normal(len(y))
    t = 1e-4 * np.arange(len(u))
    np.savetxt(file, np.column_stack([t, u, y])[::every], "%.9g", ",", header=header, comments="")
    return file


def response(model, hertz):
    z = np.exp(2j * np.pi * 1e-4 * hertz)
    A, B, C = (np.array(each) for each in (model.A, model.B, model.C))
    return np.array([C @ np.linalg.solve(point * np.eye(len(A)) - A, B) for point in z]) * z**-model.delay_cycles


@pytest.mark.parametrize(("every", "name"), [(1, "simulated"), (2, "factory")])
def test_the_model_in_the_configuration_is_that_of_the_record(every, name, cell, tmp_path, capsys):
    """Weights stay where there is an outer loop, as in the first, and are the defaults where there is none."""
    cell.write_text(before := FACTORY.with_stem(name).read_text())
    was = load_with_source(cell)[0].axes["x"].outer
    model = was.model if was else MODE
    file = stage(tmp_path / "x.csv", every, seconds=2.0 * every, model=model)
    assert code_of(file, *STAGE, "--order", len(model.A), "--into", cell) == 0
    assert "wrote axes.x.outer.model of" in capsys.readouterr().out
    assert command.code_of("check", cell) == 0
    outer = load_with_source(cell)[0].axes["x"].outer
    assert outer == (Outer(model=outer.model) if was is None else was.model_copy(update={"model": outer.model}))
    hertz = np.array([1.0, 30.0, 55.0, 60.0, 65.0, 200.0])
    assert np.abs(response(outer.model, hertz) / response(model, hertz) - 1.0).max() < 0.02
    comments = [[line for line in text.splitlines() if "#" in line] for text in (before, cell.read_text())]
    assert comments[0] == comments[1]


REFUSED = {
    "no units": ("t_s,setpoint,stage", ("setpoint", "stage"), 1, "setpoint states no unit"),
    "a voltage": ("t_s,u_V,stage_um", ("u_V", "stage_um"), 1, "u_V is in V: of linear models a configuration holds"),
    "no axis": ("t_s,a_um,b_um", ("a_um", "b_um"), 64, "w"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_what_has_no_place_is_refused_and_nothing_is_written(name, cell, tmp_path, capsys):
    header, (driven, seen), code, said = REFUSED[name]
    before = cell.read_text()
    axis = "w" if name == "no axis" else "x"
    file = stage(tmp_path / "x.csv", 1, header, 0.1)
    assert code_of(file, "--input", driven, "--output", seen, "--into", cell, "--axis", axis) == code
    assert said in capsys.readouterr().err
    assert cell.read_text() == before


def test_a_rate_that_the_loop_s_is_no_multiple_of_is_refused(cell, tmp_path, capsys):
    file = stage(tmp_path / "x.csv")
    before = cell.read_text()
    assert code_of(file, *STAGE, "--resample", "3000", "--order", "2", "--into", cell) == 1
    assert "a step of 0.000333333 s, the loop one of 0.0001 s" in capsys.readouterr().err
    assert cell.read_text() == before
