"""What a real controller tells of its axes: at rest, as one is jogged, and as the loop stands still."""

import json
import os
import signal

import pytest

from campaigns.running_controller import until
from micromanip.client import Client
from tests.cells import QUICK, SHARED, WAITING, changed

from .standin import jogging


def value(client, name, axis="x"):
    return client.status()["axes"][axis][name]


def stale_while_it_stands_still(jogged):
    os.kill(jogged.loop, signal.SIGSTOP)
    try:
        with Client(jogged.socket) as client:
            until(lambda: client.status()["axes"]["z"]["voltage_V"]["unknown"], jogged.last_words)
            stale = value(client, "voltage_V")
            assert stale["latest"] is None
            assert stale["unknown"].startswith("stale: the loop has stood still for ")
    finally:
        os.kill(jogged.loop, signal.SIGCONT)
    with Client(jogged.socket) as client:
        until(lambda: value(client, "voltage_V")["latest"] == 0.0, jogged.last_words)


def test_an_axis_is_seen_at_rest_and_as_it_is_jogged_and_not_while_the_loop_stands_still(run):
    jogged = run(changed(jogging(), *SHARED, *WAITING, *QUICK)).reach("READY")
    stale_while_it_stands_still(jogged)
    with Client(jogged.socket) as client:
        rest = client.status()["axes"]["x"]
        assert rest["voltage_V"]["latest"] == 0.0
        assert rest["headroom_V"]["latest"] == 20.0
        assert "it reads -300, and its driver says" in rest["position_um"]["unknown"], "at rest the stage is at its end"
        assert rest["strain_um"]["second"]["deviation_rms"] > 0.0, "a gauge has noise"
        assert rest["setpoint_um"]["unknown"] == "loops open"
        client.arm()
        until(lambda: client.status()["state"] == "TRACKING", jogged.last_words)
        until(lambda: abs((value(client, "strain_um")["latest"] or 0.0) - 60.0) < 2.0, jogged.last_words)
        client.jog("x", to_um=75.0)
        until(lambda: abs(value(client, "strain_um")["latest"] - 75.0) < 2.0, jogged.last_words)
        until(lambda: value(client, "setpoint_um")["latest"] == pytest.approx(75.0, abs=0.01), jogged.last_words)
        until(lambda: value(client, "strain_um")["minute"]["max"] > 74.0, jogged.last_words)
        assert value(client, "strain_um")["minute"]["min"] < 10.0, "it was at rest within the last minute"
        assert value(client, "position_um")["latest"] is not None
        assert value(client, "setpoint_um", "y")["latest"] == pytest.approx(60.0, abs=0.5)
    assert jogged.end() == 0
    final = json.loads(jogged.out)["axes"]["x"]["voltage_V"]
    assert final["latest"] is None or final["latest"] == 0.0, "parked, or known no more"
