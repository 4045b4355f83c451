"""The whole daemon on emulated EtherCAT terminals: what befalls a terminal ends at rest; nothing steps."""

import pytest

from campaigns.bench import Bench
from campaigns.running_controller import until
from tests.emulation.ethercat.wire import veth

from .held_cell import CELL, LARGEST_STEP_V, at_rest_after_a_fault, held

pytestmark = [pytest.mark.live, pytest.mark.thorough, pytest.mark.compiled_only, pytest.mark.xdist_group("loop")]
"""Thorough: the driver's own tests show the same without a daemon."""

DRIVER = """\
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
          strain: {pdo: 0x1a00, fields: {strain_x: {index: 0x6000, subindex: 1, type: int32, scale: 1.0e-4}}}"""


@pytest.fixture(scope="module")
def bench(tmp_path_factory):
    with veth("ech") as (here, _):
        bench = Bench(tmp_path_factory.mktemp("ethercat"), CELL.replace("DRIVER", DRIVER).replace("INTERFACE", here))
        yield bench
        bench.end()


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
    until(lambda: bench.link()["links"] > links and bench.link()["link"] == "up", lambda: bench.link())
    at_rest_after_a_fault(bench)
    told(bench)  # from 60 V to its safe value in one, which came when it was at rest
    held(bench)
    assert told(bench)["outputs"]["voltage_x"]["largest_step_V"] <= LARGEST_STEP_V


def test_the_loop_follows_a_terminals_clock_that_drifts(tmp_path):
    """From the configuration to the deadlines: READY waits for the lock, and the drift becomes known."""
    locked = DRIVER.replace("    silence_ms", "    lock: {within_us: 40}\n    silence_ms")
    locked = locked.replace("product: 0x1003", "product: 0x1003\n        sync0_shift_us: 60")
    with veth("ecl") as (here, _):
        bench = Bench(tmp_path, CELL.replace("DRIVER", locked).replace("INTERFACE", here))
        try:
            until(lambda: bench.link()["counts"]["locked"] == 1, lambda: bench.link())
            bench.device.order(inject="clock", terminal="amplifier", ppm=60.0)

            def knows():
                return 40_000 < bench.link()["counts"]["clock_drift_ppb"] < 80_000

            until(knows, lambda: bench.link())
        finally:
            bench.end()
