"""A candidate tuning beside a real loop that tracks: promoted without a bump and confirmed."""

import numpy as np
import pytest

from micromanip.client import Client
from micromanip.errors import CheckFailed
from micromanip.rt import mailbox as w
from tests.cells import calm, rows_of

from .whole_module import tracking_until_the_end

pytestmark = pytest.mark.realtime  # path errors of a real loop

TRIAL = ("arm_on_start: true", "shadow: {trial_s: 1.0, error_factor: 3.0}\narm_on_start: true")
MOVING = (
    "reference: {source: hold, offset_um: 65}",
    "reference: {source: sine, offset_um: 65, sines: [{frequency_Hz: 5, amplitude_um: 40}]}",
)
AXES = ("x", "y", "z")
K = "axes.x.inner.K_V_per_um"
USUAL_K = 0.6


@pytest.fixture(scope="module")
def tracking(tmp_path_factory):
    with tracking_until_the_end(tmp_path_factory.mktemp("candidate"), calm(TRIAL).replace(*MOVING)) as cell:
        yield cell


@pytest.fixture
def client(tracking):
    with Client(tracking.socket) as client:
        client.set(pid(K_V_per_um=USUAL_K))
        tracking.go_on(10_000)  # the figures of what runs are a mean over a second
        yield client
    tracking.go_on(200)
    assert tracking.state == "TRACKING"


def pid(**values):
    """Values of the PIDs of all axes."""
    return {f"axes.{axis}.inner.{key}": value for axis in AXES for key, value in values.items()}


def test_promoted_and_confirmed(tracking, client):
    before = int(tracking.status["words"][w.VERSION_ACTIVE])
    offered = client.candidate_set(pid(K_V_per_um=0.5))
    version = offered["version"]
    assert version > before
    tracking.go_on(2000)
    compared = client.candidate_show()["comparison"]
    assert all(compared[axis]["candidate"]["feedback_V"] > 0.0 for axis in AXES)
    assert client.value(K) == USUAL_K
    usual = np.abs(np.diff(rows_of(tracking.ring)[-2000:]["axis"]["voltage_V"], axis=0)).max()

    assert client.candidate_promote()["standing"] == "on trial"
    assert client.value(K) == 0.5
    with pytest.raises(CheckFailed, match="is on trial"):
        client.set({K: 0.4})
    assert client.candidate_outcome()["standing"] == "confirmed"
    rows = rows_of(tracking.ring)[-20_000:]
    at = int(np.argmax(rows["version"] == version))
    assert set(np.unique(rows["version"][at:])) == {version}
    voltage, periods = rows["axis"]["voltage_V"], rows["periods"][1:, None]
    assert (np.abs(np.diff(voltage, axis=0))[at - 1] / periods[at - 1]).max() <= 1.5 * usual
    assert client.value(K) == 0.5
    client.set(pid(K_V_per_um=USUAL_K))
