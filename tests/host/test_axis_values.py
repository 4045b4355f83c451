"""What `status` tells of each axis, from rows of the telemetry ring: known or not, and over which time."""

import re
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from micromanip.host import statistics
from micromanip.host.axis_values import BLOCK_NS, AxesValues, Windows
from micromanip.host.shared_memory import RING, STATUS
from micromanip.rt.mailbox import RING_HEAD
from micromanip.rt.states import ARMING, CLOSED, LIFTING, PARKED, TRACKING
from micromanip.rt.telemetry import ROW
from micromanip.settings.check import prepare

from .standin import SIMULATED

START_NS = 7_000_000_000_000
PERIOD_NS = 100_000
MS = 1_000_000


@pytest.fixture(scope="module")
def prepared():
    return prepare(SIMULATED)


@pytest.fixture
def controller(prepared):
    """Axis x as configured but for its truth, which no hardware tells."""
    parameters = prepared.parameters.copy()
    parameters["axis"]["path_error"] = parameters["axis"]["uncompensated"] = -1
    parameters["axis"]["stage_age_ns"] = 3 * MS
    standin = SimpleNamespace(configuration=prepared.configuration, parameters=parameters)
    return SimpleNamespace(prepared=standin, status=np.zeros(1, STATUS)[0])


def rows(count=1, phase=CLOSED):
    made = np.zeros(count, ROW)
    made["time_ns"] = START_NS + PERIOD_NS * np.arange(count)
    made["phase"], made["periods"] = phase, 1
    axis = made["axis"]
    axis["stage_um"], axis["strain_um"], axis["setpoint_um"] = 50.0, 66.0, 66.5
    axis["voltage_V"], axis["path_error_um"] = 100.0, -0.25
    return made


def report(controller, made, now_ns=None):
    values = AxesValues(controller)
    values.add(made)
    return values.report(made[-1], int(made["time_ns"][-1]) if now_ns is None else now_ns)["x"]


def latest(axis):
    return {name: value["latest"] for name, value in axis.items() if name.endswith(("_um", "_V"))}


def test_values_of_an_axis_that_tracks(controller):
    axis = report(controller, rows())
    assert latest(axis) == {
        "position_um": 50.0,
        "setpoint_um": 66.5,
        "strain_um": 66.0,
        "voltage_V": 100.0,
        "headroom_V": 50.0,  # of -20 to 150 V
        "error_um": -0.25,
    }
    assert axis["error_of"] == "path"


def test_an_axis_at_rest_has_position_strain_and_voltage_and_no_setpoint_or_error(controller):
    axis = report(controller, rows(20, PARKED))
    for name in ("setpoint_um", "error_um"):
        assert axis[name] == {"latest": None, "unknown": "loops open", "second": None, "minute": None}
    assert (axis["position_um"]["latest"], axis["strain_um"]["latest"], axis["voltage_V"]["latest"]) == (50, 66, 100)
    lifted = report(controller, rows(1, LIFTING))
    assert (lifted["setpoint_um"]["latest"], lifted["error_um"]["latest"]) == (66.5, None)


def test_an_error_counts_once_the_feedback_has_faded_in(controller):
    made = rows(100)
    made["state"][:50], made["state"][50:] = ARMING, TRACKING
    made["axis"]["path_error_um"][:50] = 40.0
    axis = report(controller, made)
    assert axis["error_um"]["minute"]["peak"] == 0.25
    made["state"][50:] = ARMING
    assert report(controller, made)["error_um"] == {
        "latest": None,
        "unknown": "loops open",
        "second": None,
        "minute": None,
    }


def test_a_sample_that_is_too_old_is_no_value_and_counts_nowhere(controller):
    made = rows(100)
    made["axis"]["stage_age_ns"][40:] = 4 * MS
    axis = report(controller, made)
    assert axis["position_um"]["latest"] is None
    assert axis["position_um"]["unknown"] == "stale: no usable sample of stage_x for 4 ms"
    assert axis["error_um"]["latest"] is None, "the error is that of the stage's sensor"
    made["axis"]["stage_um"][40:, 0] = 1e9
    assert report(controller, made)["position_um"]["second"]["max"] == 50.0


@pytest.mark.parametrize(
    ("reading", "status", "why"),
    [(-301.5, 0, "; it reads -301.5, outside -300 to 300"), (-300.0, 1, "; it reads -300, and its driver says that")],
)
def test_a_reading_that_does_not_count_is_named_as_the_reason(controller, reading, status, why):
    place = controller.prepared.parameters[0]["axis"][0]["stage"]
    controller.status["signals"][place] = (reading, START_NS, 12, status)
    made = rows()
    made["axis"]["stage_age_ns"] = 2_000_000_000
    value = report(controller, made)["position_um"]
    assert value["latest"] is None
    assert f"for 2 s or more{why}" in value["unknown"]


def test_a_loop_that_stands_still_has_no_values(controller):
    made = rows(10)
    axis = report(controller, made, now_ns=int(made["time_ns"][-1]) + 1_500 * MS)
    assert set(latest(axis).values()) == {None}
    assert axis["voltage_V"]["unknown"] == "stale: the loop has stood still for 1.5 s"
    assert axis["voltage_V"]["second"] is None
    assert axis["voltage_V"]["minute"]["mean"] == 100.0


@given(
    st.lists(st.tuples(st.integers(0, 300 * MS), st.sampled_from([np.nan, -3.0, 0.5, 7.0, 1e3])), max_size=300),
    st.integers(1, 50),
    st.sampled_from([1.0, 60.0]),
)
def test_windows_are_what_numpy_makes_of_the_values_in_them(gaps, piece, seconds):
    times = START_NS + np.cumsum([gap for gap, _ in gaps], dtype=np.int64)
    values = np.array([value for _, value in gaps])
    windows = Windows(1)
    for at in range(0, len(gaps), piece):
        windows.add(times[at : at + piece], values[at : at + piece, None])
    now = int(times[-1]) if len(gaps) else START_NS
    inside = times // BLOCK_NS > now // BLOCK_NS - round(seconds * 1e9 / BLOCK_NS)
    known = values[inside & np.isfinite(values)]
    (window,) = windows.over(seconds, now)
    if not len(known):
        assert window is None
        return
    assert window["seconds"] <= seconds
    expected = {
        "mean": known.mean(),
        "min": known.min(),
        "max": known.max(),
        "rms": np.sqrt(np.mean(known**2)),
        "peak": np.abs(known).max(),
        "deviation_rms": known.std(),
        "deviation_peak": np.abs(known - known.mean()).max(),
    }
    for name, value in expected.items():
        assert window[name] == pytest.approx(value, rel=1e-6, abs=1e-4), name


def test_the_ring_is_read_once_and_a_report_is_up_to_date(prepared, monkeypatch):
    now_ns = 5_000_000_000
    monkeypatch.setattr(statistics, "time", SimpleNamespace(monotonic_ns=lambda: now_ns))
    ring = np.zeros(1, RING)[0]
    ring["rows"]["time_ns"] = now_ns
    controller = SimpleNamespace(prepared=prepared, ring=ring, status=np.zeros(1, STATUS)[0])
    gathered = statistics.Gathered(controller)
    for row in range(2):
        ring["rows"]["axis"]["voltage_V"][row] = 10.0 + row
        ring["words"][RING_HEAD] = row + 1
        gathered.gather()
        value = gathered.axes()["y"]["voltage_V"]
        assert (value["latest"], value["second"]["max"]) == (10.0 + row, 10.0 + row)
    gathered.gather()
    assert gathered.axes()["y"]["voltage_V"]["second"]["mean"] == 10.5, "no row counts twice"


@pytest.mark.parametrize(
    ("reference", "truth", "known"),
    [
        ("{source: hold, offset_um: 60}", False, False),  # nothing deviates: 60 um are no path error
        ("{source: hold, offset_um: 60}", True, True),
        ("{source: signal}", False, True),
    ],
)
def test_uncompensated_is_told_only_where_something_deviates(tmp_path, reference, truth, known):
    text = re.sub(r"(?m)^reference:\n(  .*\n)+", f"reference: {reference}\n", SIMULATED.read_text())
    if not truth:
        text = re.sub(r"(?m)^  (path_error|uncompensated)_[xyz]: .*\n", "", text)
    (tmp_path / "cell.yaml").write_text(text)
    status = np.zeros(1, STATUS)[0]
    figures = status["state"][0]["figures"][0]
    figures["errors"], figures["error_squares"], figures["uncompensated_squares"] = 100, 25.0, 360_000.0
    controller = SimpleNamespace(prepared=prepare(tmp_path / "cell.yaml"), status=status)
    found = statistics.path_errors(controller)["x"]
    assert found["rms"] == 0.5
    assert found["uncompensated_rms"] == (60.0 if known else None)
