"""Measured recordings that others have published figures for; skipped where they are not beside the project."""

from pathlib import Path

import numpy as np
import pytest

from micromanip.design.identify.linear.experiments import load_linear
from micromanip.design.identify.linear.selection import select
from micromanip.design.identify.linear.validated import fit_records
from micromanip.recordings import Wanted
from tests.further import further

from .oracles import arx, n4sid

DATA = Path(__file__).parents[4].parent / "shared" / "data"


def folder(name):
    if not (DATA / name).is_dir():
        pytest.skip(f"the real recordings are not here: {name} is not beside the project")
    return DATA / name


@pytest.mark.parametrize(("name", "percent"), [("robot_arm", 96.0), ("dryer", 89.0)])
def test_daisy(name, percent):
    """Second half in free run, fitted on the first."""
    record = load_linear(folder("daisy") / f"{name}.dat", Wanted(("1", "2"), step_s=1.0), 1)
    result = fit_records([record], None, 4, 0.5)
    assert result.model.order == 4
    assert result.fit_percent[0] >= percent


def daisy(name):
    return np.split(np.loadtxt(folder("daisy") / f"{name}.dat"), 2, axis=1)


def yan9a(name):
    table = np.loadtxt(folder("yan9a_piezo") / f"{name}.csv", delimiter=",", skiprows=1)
    return table[:, 1:2], table[:, 2:3]


def fsm(level, outputs=slice(3)):
    """One period of one realisation: three voltages, three displacements."""
    u, y = (np.load(folder("fsm") / f"{name}_{level}mV_train.npy")[:, :, 0, 0] for name in "uy")
    return u, y[:, outputs]


RECORDS = {
    "robot_arm": lambda: daisy("robot_arm"),
    "dryer": lambda: daisy("dryer"),
    "model_1hz": lambda: yan9a("model_1hz"),
    "test_amplitudes": lambda: yan9a("test_amplitudes"),
    "fsm 100 mV, output 1": lambda: fsm(100, slice(1)),
    "fsm 300 mV, output 2": lambda: fsm(300, slice(1, 2)),
    "fsm 300 mV": lambda: fsm(300),
}
WIDE = (4, 8, 16, 28)


@pytest.mark.long  # a fit, and a dozen of each oracle
@pytest.mark.parametrize("name", [*list(RECORDS)[:4], *further(*list(RECORDS)[4:])])
def test_no_oracle_of_any_order_is_better_by_three_points(name, record_property):
    """Fitted to the first half, judged on the second; the oracles' orders are the best for that half."""
    u, y = RECORDS[name]()
    half = len(u) // 2
    first, second = (u[:half], y[:half]), (u[half:], y[half:])
    ours = select([first], [second], 1.0, None).model
    percent = float(np.mean(ours.errors(*second)[0]))
    orders = WIDE if y.shape[1] > 1 else range(1, 13)
    best = {
        "ARX": max((arx(*first, n).fit_percent(*second), n) for n in orders if n * y.shape[1] <= 36),
        "N4SID": max((n4sid(*first, n).fit_percent(*second), n) for n in orders),
    }
    told = ", ".join(f"{method} {fit:.2f} % (order {n})" for method, (fit, n) in best.items())
    record_property("fits", f"{name}: {percent:.2f} % (order {ours.order}), {told}")
    assert percent > max(fit for fit, _ in best.values()) - 3.0, told
