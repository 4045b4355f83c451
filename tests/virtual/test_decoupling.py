"""Coupled axes in virtual time: what ignoring it costs, that decoupling takes that away, and that it comes smoothly."""

from pathlib import Path

import numpy as np
import pytest
import yaml

from campaigns.report import CONFIG
from micromanip.design.analyse.coupling import measure_coupling
from micromanip.rt.shadow import swap_cell
from micromanip.settings.check import prepared
from micromanip.settings.compile.cell import compile_cell
from micromanip.settings.text.source import Source
from micromanip.virtual.cell import VirtualCell
from micromanip.virtual.experiment import VirtualExperiment

pytestmark = pytest.mark.compiled_only
SIMULATED = CONFIG / "simulated.yaml"
NAMES, SECONDS, SEED = "xyz", 6.0, 1
SHARES = np.array([[1.0, 0.05, -0.033], [-0.033, 1.0, 0.05], [0.05, -0.033, 1.0]])
NONE = np.eye(3)


def document(shares, *, decouple=None, flexure=0.0):
    """The tuned cell with a coupling, and `decouple` as its axes' sections say; None: they say nothing."""
    read = yaml.safe_load(SIMULATED.read_text(encoding="utf-8"))
    read["drivers"]["cell"] |= {"couplings": np.asarray(shares).tolist(), "flexure_coupling": flexure}
    if decouple is not None:
        for i, name in enumerate(NAMES):
            seen = {other: float(shares[i][j]) for j, other in enumerate(NAMES) if j != i}
            read["axes"][name]["coupling"] = {"share": seen, "decouple": decouple}
    return read


def cell(shares, **said):
    return prepared(Source.parse(Path("cell.yaml"), yaml.safe_dump(document(shares, **said), sort_keys=False)))


@pytest.fixture(scope="module")
def errors():
    """Path error (n, axes) with the same noise: not coupled, ignored, decoupled."""
    cells = cell(NONE), cell(SHARES, decouple=False), cell(SHARES, decouple=True)
    return [
        VirtualExperiment(each)(each.configuration, SECONDS)["axis"]["path_error_um"][20_000:, :3] for each in cells
    ]


@pytest.fixture(scope="module")
def measured():
    return measure_coupling((coupled := cell(SHARES)).configuration, VirtualExperiment(coupled), SEED)


@pytest.mark.long
def test_decoupling_takes_away_what_coupling_adds(errors):
    added = [np.sqrt(np.mean((coupled - errors[0]) ** 2, axis=0)) for coupled in errors[1:]]
    assert added[0].min() > 0.02, "5 % of 30 um of the joints' oscillation are seen"
    assert (added[1] < 0.25 * added[0]).all()


@pytest.mark.long
def test_the_coupling_is_measured_within_its_uncertainty(measured):
    away = np.abs(measured.rest - SHARES)[~np.eye(3, dtype=bool)]
    allowed = (4.0 * measured.rest_deviation)[~np.eye(3, dtype=bool)]
    assert (away < np.maximum(allowed, 1e-3)).all()
    assert measured.rest_deviation.max() < 1e-3
    assert measured.sure.sum() == 6
    assert np.abs(measured.gauge - np.eye(3)).max() < 1e-3


def test_a_share_that_is_only_known_changes_nothing():
    known, plain = (
        compile_cell(each.configuration, each.wiring) for each in (cell(SHARES, decouple=False), cell(SHARES))
    )
    assert known.tobytes() == plain.tobytes()


@pytest.mark.long
def test_it_is_switched_on_and_off_while_tracking_without_a_jump():
    on, off = cell(SHARES, decouple=True), cell(SHARES, decouple=False)
    virtual = VirtualCell(off.parameters.copy(), off.wiring, off.samples)
    virtual.arm()
    rows = [virtual.run(1.0)]
    for each in (on, off):
        swap_cell(virtual.parameters[0], each.parameters[0], virtual.state[0])
        virtual.parameters[:] = each.parameters
        rows.append(virtual.run(1.5))
    steps = [np.abs(np.diff(part["axis"]["setpoint_um"][:, :3], axis=0)).max(axis=0) for part in rows]
    for later in steps[1:]:
        assert (later < 1.5 * steps[0]).all()
    added = virtual.state["axis"]["added_um"][0]
    assert not added.any()
