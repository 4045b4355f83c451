"""The whole daemon on a device of the driver `udp`: short breaks, long ones, stalls and kills; nothing steps."""

import time

import pytest

from tools.bus_faults.bench import Bench
from tools.bus_faults.cells import free_port
from tools.running_controller import until

pytestmark = [pytest.mark.live, pytest.mark.xdist_group("loop")]

HELD_V, STEP_V, RESOLVED_V = 60.0, 1.0, 2e-4
"""Half a volt a millisecond, at 500 Hz."""
REST_S = 0.35

CELL = """\
schema_version: 2
loop: {rate_hz: 500, cpu: null, spin_us: 0, limits: simulation}
start: {lift_s: 0.3, check_s: null, sweep_s: 0.0, settle_s: 0.0, authority_s: 0.1, ramp_s: 0.3}
drivers:
  cell:
    driver: udp
    simulated: true
    host: 127.0.0.1
    port: PORT
    silence_ms: 50
    watchdog: {ms: 100, rest_ms: 250, does: the amplifier ramps to 0 V in 0.2 s}
    crc: {name: crc32.iso_hdlc}
    receive:
      counter: {at: 0, type: uint16, byte_order: little}
      acknowledges: {at: 2, type: uint16, byte_order: little}
      fields: {strain_x: {at: 4, type: int32, byte_order: little, scale: 1.0e-4}}
    send:
      counter: {at: 0, type: uint16, byte_order: little}
      cyclic_safe: true
      fields: {voltage_x: {at: 4, type: int32, byte_order: little, scale: 1.0e-4, range: [-20, 100]}}
signals: {strain_x: {driver: cell, max_age_us: null}}
outputs: {voltage_x: {driver: cell, range_V: [-20, 100], slew_V_per_ms: 0.5, park_V: 0}}
reference: {source: hold, offset_um: 60}
axes:
  x:
    mode: voltage
    centre_um: 66
    setpoint: {range_um: [2, 128], slew_um_per_ms: 0.5}
    inner: {mode: pid, K_V_per_um: 0.08, Ti_ms: 5.0, Td_ms: 0.0, filter_ms: 1.0}
simulation: {seed: 1, axes: [x], lines: {}}
faults: {hold: {timeout_s: 0.3}}
"""


@pytest.fixture(scope="module")
def bench(tmp_path_factory):
    bench = Bench(tmp_path_factory.mktemp("udp"), CELL.replace("PORT", str(free_port())))
    yield bench
    bench.end()


def told(bench):
    """Figures of what the device got since the last call, and where its amplifier stands."""
    report = bench.device.report()
    return report["outputs"]["voltage_x"], report


def held(bench):
    """Tracking, at its voltage."""
    bench.track()
    until(lambda: bench.link()["given"]["voltage_x"] == pytest.approx(HELD_V, abs=0.1), lambda: bench.link())
    assert (bench.link()["link"], bench.link()["outputs"]) == ("up", "following")


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
    assert told(bench)[0]["largest_step_V"] <= STEP_V + RESOLVED_V


def test_a_loop_that_stood_still_for_a_moment_makes_no_step(bench):
    held(bench)
    told(bench)
    bench.running.stall(0.04)
    time.sleep(0.2)
    held(bench)
    assert told(bench)[0]["largest_step_V"] <= STEP_V + RESOLVED_V


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
    until(lambda: bench.running.state == "FAULT", bench.running.last_words)
    until(lambda: bench.link()["outputs"] == "following", lambda: bench.link())  # the loop, in fault, asks for rest
    assert bench.link()["given"] == {"voltage_x": 0.0}
    assert told(bench)[1]["amplifier_trips"] == trips + 1
    held(bench)
    assert told(bench)[0]["largest_step_V"] <= STEP_V + RESOLVED_V
    assert bench.link()["links"] >= 2


def test_all_killed_the_watchdog_brings_it_to_rest(bench):
    held(bench)
    trips = told(bench)[1]["amplifier_trips"]
    bench.running.kill()
    until(lambda: told(bench)[1]["amplifier_trips"] == trips + 1, "no trip")
    time.sleep(REST_S)
    bench.start_again()
    told(bench)
    held(bench)
    assert told(bench)[0]["largest_step_V"] <= STEP_V + RESOLVED_V
