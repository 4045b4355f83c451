"""Sensitivity measured on a real loop: softly, let go where nobody asks any more, gone with the state."""

import json
import time

import numpy as np
import pytest
from click.testing import CliRunner

from campaigns.running_controller import PATIENCE_S, until
from micromanip.cli.main import cli
from micromanip.client import Client
from micromanip.control.injection import FADE_S, LEAD_S, PERIOD_S, PERIODS
from micromanip.errors import CheckFailed
from tests.cells import calm

from .whole_module import tracking_until_the_end

pytestmark = [pytest.mark.live, pytest.mark.realtime]  # one that misses many cycles is late, and gives no spectra
SECONDS = 2 * FADE_S + LEAD_S + PERIODS * PERIOD_S


@pytest.fixture(scope="module")
def cell(tmp_path_factory):
    """It runs half as often as others: moves and injections last for seconds."""
    text = calm(("rate_hz: 10000", "rate_hz: 5000"))
    with tracking_until_the_end(tmp_path_factory.mktemp("injections"), text) as cell:
        yield cell


@pytest.fixture
def tracking(cell):
    with Client(cell.socket) as client:
        track(client)
    return cell


def level(cell, axis=0):
    return float(cell.status["state"][0]["axis"][axis]["excitation"]["level"])


def lines(cell, axis=0):
    slots = cell.control["parameters"]
    in_force = slots[slots["version"] == cell.status["state"][0]["version"]][0]
    return int(in_force["axis"][axis]["excitation"]["lines"])


def track(client):
    if client.status()["state"] in {"READY", "HOLDING"}:
        client.arm()
    until(lambda: client.status()["state"] == "TRACKING", "it does not track")


def where_the_machine_lets_it(attempt):
    """What `attempt()` returns; once more where it is refused, as it should be: the machine stood still, so that
    cycles were missed, or samples too old.
    """
    end = time.monotonic() + PATIENCE_S
    while True:
        try:
            return attempt()
        except CheckFailed as refused:
            stood = any(why in str(refused) for why in ("of the cycles were missed", "is not usable"))
            if not stood or time.monotonic() > end:
                raise


def typed(*arguments):
    """The JSON that a command prints."""

    def once():
        done = CliRunner().invoke(cli, [str(each) for each in (*arguments, "--json")])
        if not done.stdout:
            raise done.exception
        return json.loads(done.stdout)

    return where_the_machine_lets_it(once)


def test_it_is_measured_while_nothing_else_may_be_changed_and_leaves_nothing(tracking):
    with Client(tracking.socket) as client, Client(tracking.socket) as other:

        def measured():
            begun = client.request("analyse_live", axis="x", loop="strain")
            assert begun["seconds"] == pytest.approx(SECONDS)
            assert begun["simulated"]
            with pytest.raises(CheckFailed, match="the sensitivity of axis x, strain loop, is being measured"):
                other.set({"axes.x.inner.K_V_per_um": 0.5})
            with pytest.raises(CheckFailed, match="is being measured"):
                other.analyse_live("y", "strain", 0.3)
            highest = 0.0
            while not (found := client.request("analyse_live", number=begun["number"]))["done"]:
                highest = max(highest, level(tracking))
                time.sleep(0.1)
            assert highest == 1.0
            return found

        found = where_the_machine_lets_it(measured)
        U, Y = (np.array(found[name]) @ [1.0, 1j] for name in ("input", "output"))
        gain = np.abs(Y.mean(axis=0) / U.mean(axis=0))
        low = np.array(found["frequency_Hz"]) < 30.0
        assert np.median(gain[low]) == pytest.approx(0.7, rel=0.4), "the actuator's um per V"
        assert lines(tracking) == 0
        refused = [entry["verb"] for entry in other.log(50)["entries"] if not entry["accepted"]]
        assert "analyse_live" in refused
        other.set({"axes.x.inner.K_V_per_um": 0.6})


def test_it_is_taken_back_where_the_client_goes_away(tracking):
    with Client(tracking.socket) as client:
        number = client.request("analyse_live", axis="y", loop="strain")["number"]
        until(lambda: level(tracking, 1) > 0.0, "no injection")
    until(lambda: lines(tracking, 1) == 0, "it goes on")
    with Client(tracking.socket) as client, pytest.raises(CheckFailed, match="nobody has asked for it for 1 s"):
        client.request("analyse_live", number=number)


def test_the_command(tracking, tmp_path):
    """Held, as the manual says; a page and one document."""
    with Client(tracking.socket) as client:
        client.hold()
    arguments = ("--axis", "x", "--out", tmp_path / "out", "--socket", tracking.socket)
    document = typed("analyse", "live", *arguments)
    assert (document["axis"], document["loop"]) == ("x", "strain")
    assert 1.0 < document["measured"]["Ms"] < 4.0
    assert document["agrees"] is None, "the configuration has no model of the actuator"
    assert (tmp_path / "out" / "live_x_strain.html").exists()


def test_a_disarm_ends_it_at_once(tracking):
    with Client(tracking.socket) as client:
        track(client)
        number = client.request("analyse_live", axis="x", loop="strain")["number"]

        def in_full():  # asked for again and again, or it is taken back
            return not client.request("analyse_live", number=number)["done"] and level(tracking) == 1.0

        until(in_full, "no injection")
        client.disarm()
        until(lambda: level(tracking) == 0.0, "it goes on")
        with pytest.raises(CheckFailed, match=r"was ended: the state is (RAMPING|READY), it began while"):
            until(lambda: client.request("analyse_live", number=number)["done"], "it does not end")
        until(lambda: client.status()["state"] == "READY" and lines(tracking) == 0, "it does not rest")
        track(client)
