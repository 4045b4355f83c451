"""One axis held at a voltage by the whole daemon, on the device of a driver that serves its wire in the loop."""

import pytest

from campaigns.running_controller import until

HELD_V, LARGEST_STEP_V = 60.0, 1.0 + 2e-4
"""Half a volt a millisecond, at 500 Hz, as the wire resolves it."""

CELL = """\
schema_version: 2
loop: {rate_hz: 500, cpu: null, spin_us: 0, limits: simulation}
start: {lift_s: 0.3, check_s: null, sweep_s: 0.0, settle_s: 0.0, authority_s: 0.1, ramp_s: 0.3}
drivers:
DRIVER
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
"""DRIVER is the driver `cell`, with the channels `strain_x` and `voltage_x`."""


def held(bench):
    """Tracking, at its voltage."""
    bench.track()
    until(lambda: bench.link()["given"]["voltage_x"] == pytest.approx(HELD_V, abs=0.1), lambda: bench.link())
    assert (bench.link()["link"], bench.link()["outputs"]) == ("up", "following")


def at_rest_after_a_fault(bench):
    """The loop is in fault, which asks for rest, and the device follows it there."""
    until(lambda: bench.running.state == "FAULT", bench.running.last_words)
    until(lambda: bench.link()["outputs"] == "following", lambda: bench.link())
    assert bench.link()["given"] == {"voltage_x": 0.0}
