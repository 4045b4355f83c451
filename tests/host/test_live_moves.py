"""Moves of a held axis on a real loop: played, let go where nobody asks any more, and gone with the hold."""

import pytest

from micromanip.client import Client
from micromanip.errors import CheckFailed
from tools.running_controller import until

pytestmark = [pytest.mark.live, pytest.mark.realtime]  # a loop that misses many cycles takes longer than it may
SINE = {"axis": "x", "kind": "sine", "amplitude_um": 5.0, "frequency_Hz": 2.0, "seconds": 20.0}


@pytest.fixture(scope="module")
def holding(measured_cell):
    with Client(measured_cell.socket) as client:
        client.hold()
    return measured_cell


def state(cell):
    return cell.status["state"][0]["axis"][0]


def in_force(cell):
    slots = cell.control["parameters"]
    return int(slots[slots["version"] == cell.status["state"][0]["version"]][0]["axis"][0]["move"]["kind"])


def resting(cell):
    until(lambda: in_force(cell) == 0, "it goes on")
    place = float(state(cell)["setpoint_um"])
    cell.go_on(500)
    assert float(state(cell)["setpoint_um"]) == place, "it rests there"


def test_a_step_goes_there_and_back_and_is_noted(holding):
    before, seen = float(state(holding)["setpoint_um"]), []
    with Client(holding.socket) as client:
        done = client.move("x", "step", by_um=8.0, progress=lambda at: seen.append(at["offset_um"]))
        assert (done["done"], done["progress"], done["offset_um"]) == (True, 1.0, 0.0)
        assert max(seen) == pytest.approx(8.0, abs=0.01)
        assert float(state(holding)["setpoint_um"]) == pytest.approx(before, abs=1e-6)
        (entry,) = client.audit(1)["entries"]
        assert (entry["verb"], entry["accepted"]) == ("move", True)
        assert "by_um 8" in entry["changes"][0]["new"]
        assert client.status()["state"] == "HOLDING", "nothing has armed it"
    resting(holding)


def test_nothing_else_is_changed_or_armed_meanwhile_and_hold_lets_it_rest(holding):
    with Client(holding.socket) as client, Client(holding.socket) as other:
        begun = client.request("move", **SINE)
        until(lambda: state(holding)["move"]["passed"] > 3000, "it does not move")
        client.request("move", number=begun["number"])
        with pytest.raises(CheckFailed, match="arm refused: a sine of axis x is under way"):
            other.arm()
        with pytest.raises(CheckFailed, match="a sine of axis x is under way"):
            other.set({"axes.x.inner.K_V_per_um": 0.5})
        other.hold()
        with pytest.raises(CheckFailed, match="the move was stopped: hold was asked for; the axis is held"):
            until(lambda: client.request("move", number=begun["number"])["done"], "it does not end")
        assert client.status()["state"] == "HOLDING"
    resting(holding)


def test_it_comes_to_rest_where_the_client_goes_away(holding):
    with Client(holding.socket) as client:
        number = client.request("move", **SINE)["number"]
        until(lambda: state(holding)["move"]["passed"] > 1000, "it does not move")
    resting(holding)
    with Client(holding.socket) as client, pytest.raises(CheckFailed, match="nobody has asked for it for 1 s"):
        client.request("move", number=number)


def test_a_disarm_ends_it_at_once_and_it_does_not_go_on(holding):
    with Client(holding.socket) as client:
        number = client.request("move", **SINE)["number"]
        until(lambda: state(holding)["move"]["passed"] > 1000, "it does not move")
        client.disarm()
        with pytest.raises(CheckFailed, match="ended by the loop: the state is"):
            until(lambda: client.request("move", number=number)["done"], "it does not end")
        until(lambda: client.status()["state"] == "READY" and in_force(holding) == 0, "it does not rest")
        client.arm()
        until(lambda: client.status()["state"] == "TRACKING", "it does not track")
        client.hold()
    assert state(holding)["move"]["speed_um"] == 0.0
    resting(holding)
