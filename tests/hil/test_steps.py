"""What a device sees while links are cut, and workers, loop and host are stopped or killed: never more than one step.

The device has no watchdog of its own here, so each value that it gets is in force.
"""

import os
import signal
import time
from contextlib import contextmanager

import pytest

from campaigns.bench import Bench
from campaigns.running_controller import until
from tests.further import further

from .step_cells import BUSES, CUTS, HELD_V, PARK_V, RAMP_S, RANGE_V, SERIAL_LINE, step_cell, step_V

pytestmark = [pytest.mark.live, pytest.mark.xdist_group("loop")]  # an emulated device goes before ordinary work

NEVER_MS = 3.6e6
RESOLVED_V = 0.01
BREAK_S = 5 * RAMP_S


@contextmanager
def held(folder, bus):
    """A bench whose axis is held at its voltage."""
    bench = Bench(folder, step_cell(bus), NEVER_MS)
    try:
        bench.track()
        until(lambda: voltage(bench) == pytest.approx(HELD_V, abs=0.1), lambda: bench.link())
        bench.device.report()
        yield bench
    finally:
        bench.end()


def voltage(bench):
    """What the daemon says that the device was given last."""
    return bench.link()["given"]["voltage_x"]


def figures(bench):
    """Of what the device got since the last call, of one voltage at least."""
    found = {"samples": 0}

    def something_came():
        found.update(bench.device.report()["outputs"]["voltage_x"])
        return found["samples"]

    until(something_came, lambda: "nothing came")
    return found


def terminal(bus):
    """What the device's name leads to now; None on another bus."""
    return os.path.realpath(SERIAL_LINE) if bus == "line" else None


def taken(path):
    """The pseudo terminal of this path, once it is free, for the test; descriptors."""
    descriptors = []

    def have_it():
        descriptors.extend(os.openpty())
        return os.ttyname(descriptors[-1]) == path

    until(have_it, lambda: path)
    return descriptors


def went_well(bench, bus):
    """To rest and in the loop's hand again, with no step and no value out of range on the way."""
    until(lambda: bench.link()["outputs"] in ("at rest", "following"), lambda: bench.link())
    seen = figures(bench)
    bench.track()
    back = figures(bench)
    for found in (seen, back):
        assert found["largest_step_V"] <= step_V(bus) + RESOLVED_V
        assert RANGE_V[0] - RESOLVED_V <= found["min"] <= found["max"] <= RANGE_V[1] + RESOLVED_V
    return seen


@pytest.mark.parametrize("bus", ["can", "gcs", *further(*sorted(BUSES.keys() - {"can", "gcs"}))])
def test_no_step_whatever_is_cut_stopped_or_killed(tmp_path, bus):
    with held(tmp_path, bus) as bench:
        path = terminal(bus)
        bench.device.order(inject=CUTS[bus], for_s=BREAK_S)
        until(lambda: bench.link()["outputs"] == "unknown", lambda: bench.link())
        assert voltage(bench) > 0.5 * HELD_V
        others = taken(path) if bus == "line" else []  # so that it comes back under another one
        until(lambda: bench.running.state == "FAULT", lambda: bench.running.last_words())
        time.sleep(BREAK_S)
        assert went_well(bench, bus)["min"] == pytest.approx(PARK_V, abs=RESOLVED_V)
        assert (terminal(bus) != path) == (bus == "line")
        for descriptor in others:
            os.close(descriptor)

        os.kill(bench.worker, signal.SIGKILL)
        time.sleep(BREAK_S)
        assert went_well(bench, bus)["min"] == pytest.approx(PARK_V, abs=RESOLVED_V)

        for stop_s in (0.05, 0.15, 0.5):
            bench.running.stall(stop_s)
            time.sleep(RAMP_S)
            went_well(bench, bus)

        os.kill(bench.running.process.pid, signal.SIGKILL)  # the loop ramps down by itself, and the worker leaves then
        until(lambda: not bench.running.left, lambda: f"left: {bench.running.left}")
        seen = figures(bench)
        assert seen["largest_step_V"] <= step_V(bus) + RESOLVED_V
        assert seen["min"] == pytest.approx(PARK_V, abs=RESOLVED_V)


@pytest.mark.parametrize("bus", ["can", *further("modbus")])
def test_everything_killed_and_started_again_goes_on_from_where_the_device_is(tmp_path, bus):
    """By the file of what was given last, and by what the device says."""
    with held(tmp_path, bus) as bench:
        assert figures(bench)["max"] == pytest.approx(HELD_V, abs=0.1)
        bench.running.kill()
        bench.start_again()
        until(lambda: bench.link()["outputs"] == "following", lambda: bench.link())
        seen = figures(bench)
        assert seen["largest_step_V"] <= step_V(bus) + RESOLVED_V
        assert seen["min"] == pytest.approx(PARK_V, abs=RESOLVED_V)
