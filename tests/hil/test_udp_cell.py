"""The whole daemon on a device of the driver `udp`: short breaks, long ones, stalls and kills; nothing steps."""

import time

import pytest

from campaigns.bench import Bench
from campaigns.fault_cells import free_port
from campaigns.running_controller import until

from .held_cell import CELL, LARGEST_STEP_V, at_rest_after_a_fault, held

pytestmark = [pytest.mark.live, pytest.mark.xdist_group("loop")]

REST_S = 0.35

DRIVER = """\
  cell:
    driver: udp
    simulated: true
    host: 127.0.0.1
    port: PORT
    silence_ms: 50
    restart_ms: 50
    watchdog: {ms: 100, rest_ms: 250, after_power_on: rest}
    crc: {name: crc32.iso_hdlc}
    receive:
      counter: {at: 0, type: uint16, byte_order: little}
      acknowledges: {at: 2, type: uint16, byte_order: little}
      fields: {strain_x: {at: 4, type: int32, byte_order: little, scale: 1.0e-4}}
    send:
      counter: {at: 0, type: uint16, byte_order: little}
      cyclic_safe: true
      fields: {voltage_x: {at: 4, type: int32, byte_order: little, scale: 1.0e-4, range: [-20, 100]}}"""


@pytest.fixture(scope="module")
def bench(tmp_path_factory):
    bench = Bench(tmp_path_factory.mktemp("udp"), CELL.replace("DRIVER", DRIVER).replace("PORT", str(free_port())))
    yield bench
    bench.end()


def told(bench):
    """Figures of what the device got since the last call, and where its amplifier stands."""
    report = bench.device.report()
    return report["outputs"]["voltage_x"], report


def test_breaks_too_short_to_be_one_make_no_step_on_the_way_up(bench):
    """What the loop has done meanwhile is caught up with step by step."""
    bench.rest()
    told(bench)
    with bench.client() as client:
        client.arm()
    until(lambda: bench.link()["given"]["voltage_x"] > 1.0, lambda: bench.link())
    for _ in range(3):
        bench.device.order(inject="unplug", for_s=0.03)
        time.sleep(0.05)
    held(bench)
    assert bench.link()["counts"]["held_back"] > 0
    assert told(bench)[0]["largest_step_V"] <= LARGEST_STEP_V


def test_a_loop_that_stood_still_for_a_moment_makes_no_step(bench):
    held(bench)
    told(bench)
    bench.running.stall(0.04)
    time.sleep(0.2)
    held(bench)
    assert told(bench)[0]["largest_step_V"] <= LARGEST_STEP_V


@pytest.mark.parametrize("break_", ["cut", "stall"])
def test_a_long_break_leaves_the_device_to_its_watchdog_and_it_comes_back_at_rest(bench, break_):
    held(bench)
    trips = told(bench)[1]["amplifier_trips"]
    if break_ == "cut":
        bench.device.order(inject="unplug", for_s=0.5)
        until(lambda: bench.link()["outputs"] == "unknown", lambda: bench.link())
    else:
        bench.running.stall(0.5)
    until(lambda: bench.link()["link"] == "up", lambda: bench.link())
    at_rest_after_a_fault(bench)
    assert told(bench)[1]["amplifier_trips"] > trips
    held(bench)
    assert told(bench)[0]["largest_step_V"] <= LARGEST_STEP_V
    assert bench.link()["links"] >= 2


def test_all_killed_the_watchdog_brings_it_to_rest(bench):
    held(bench)
    trips = told(bench)[1]["amplifier_trips"]
    bench.running.kill()
    until(lambda: told(bench)[1]["amplifier_trips"] > trips, "no trip")
    time.sleep(REST_S)
    bench.start_again()
    told(bench)
    held(bench)
    assert told(bench)[0]["largest_step_V"] <= LARGEST_STEP_V
