"""The whole daemon on emulated EtherCAT terminals: what befalls a terminal ends at rest; nothing steps."""

import pytest

from tests.emulation.ethercat.wire import veth
from tools.bus_faults.bench import Bench
from tools.running_controller import until

pytestmark = [pytest.mark.live, pytest.mark.thorough, pytest.mark.compiled_only, pytest.mark.xdist_group("loop")]
"""Thorough: the driver's own tests show the same without a daemon."""

HELD_V, STEP_V, RESOLVED_V = 60.0, 1.0, 2e-4
"""Half a volt a millisecond, at 500 Hz."""

CELL = """\
schema_version: 2
loop: {rate_hz: 500, cpu: null, spin_us: 0, limits: simulation}
start: {lift_s: 0.3, check_s: null, sweep_s: 0.0, settle_s: 0.0, authority_s: 0.1, ramp_s: 0.3}
drivers:
  cell:
    driver: ethercat
    simulated: true
    interface: INTERFACE
    silence_ms: 200
    watchdog: {ms: 500, rest_ms: 250, does: the amplifier ramps to 0 V in 0.2 s}
    cyclic_safe: true
    terminals:
      amplifier:
        vendor: 0x4d4d
        product: 0x1003
        outputs:
          voltages:
            pdo: 0x1600
            fields: {voltage_x: {index: 0x7000, subindex: 1, type: int32, scale: 1.0e-4, range: [-20, 100]}}
      gauge:
        vendor: 0x4d4d
        product: 0x1004
        inputs:
          strain: {pdo: 0x1a00, fields: {strain_x: {index: 0x6000, subindex: 1, type: int32, scale: 1.0e-4}}}
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
    with veth("ech") as (here, _):
        bench = Bench(tmp_path_factory.mktemp("ethercat"), CELL.replace("INTERFACE", here))
        yield bench
        bench.end()


def held(bench):
    """Tracking, at its voltage."""
    bench.track()
    until(lambda: bench.link()["given"]["voltage_x"] == pytest.approx(HELD_V, abs=0.1), lambda: bench.link())
    assert (bench.link()["link"], bench.link()["outputs"]) == ("up", "following")


def told(bench):
    """Figures of what the terminals got since the last call."""
    return bench.device.report()


@pytest.mark.parametrize(
    "fault",
    [
        {"inject": "left_op", "terminal": "amplifier", "code": 0x1D},
        {"inject": "power", "terminal": "gauge", "for_s": 0.5},
    ],
)
def test_what_befalls_a_terminal_ends_at_rest_and_is_taken_up_there(bench, fault):
    held(bench)
    links, _ = bench.link()["links"], told(bench)
    bench.device.order(**fault)
    until(lambda: bench.running.state == "FAULT", bench.running.last_words)
    until(lambda: bench.link()["links"] > links and bench.link()["link"] == "up", lambda: bench.link())
    until(lambda: bench.link()["outputs"] == "following", lambda: bench.link())  # the loop, in fault, asks for rest
    assert bench.link()["given"] == {"voltage_x": 0.0}
    told(bench)  # from 60 V to its safe value in one, which came when it was at rest
    held(bench)
    assert told(bench)["outputs"]["voltage_x"]["largest_step_V"] <= STEP_V + RESOLVED_V
