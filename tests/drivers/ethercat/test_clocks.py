"""Deadlines on the first terminal's clock, and SYNC0: on a line of emulated terminals, and what is refused."""

import contextlib
import struct
import time

import numpy as np
import pytest
from micromanip_drivers.ethercat import exchange
from micromanip_drivers.ethercat.bring_up import SYNC0_BEGINS_IN_S, begin_sync0, require_clocks, set_clocks
from micromanip_drivers.ethercat.driver import Ethercat
from pydantic import ValidationError

from micromanip.bus.errors import DeviceFault
from micromanip.bus.ethercat.al_states import ERROR, NO_SYNC, OP, PREOP, SAFEOP
from micromanip.bus.ethercat.registers import (
    DC_ACTIVATE,
    DC_DELAY,
    DC_OFFSET,
    DC_SPEED_START,
    DC_START,
    DC_SYNC0_CYCLE,
    DC_SYSTEM,
    FEATURES,
    FPRD,
    FPWR,
    SYNC0_ON,
    SYNC_ON,
)
from micromanip.emulation.ethercat.controller import system_ns
from micromanip.rt.bus_image import DOWN, TAKEN
from tests.emulation.ethercat.test_line import Bench as Slaves
from tests.emulation.ethercat.wire import veth

from .bench import AMPLIFIER, GAUGE, PERIOD_NS, Bench, options

SHIFT_NS = 40_000
LOCK = {"time_constant_ms": 20.0, "within_us": 40.0, "drift_ppm": 200.0}
SYNCED = {"terminals": {"amplifier": AMPLIFIER | {"sync0_shift_us": 1e-3 * SHIFT_NS}, "gauge": GAUGE}}


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"clocks": False, "lock": LOCK}, "lock: needs clocks: true"),
        (SYNCED, "terminals.amplifier.sync0_shift_us: needs lock"),
        ({"lock": LOCK | {"drift_ppm": 0.0}}, "greater than 0"),
    ],
)
def test_a_lock_without_a_clock_is_refused(changes, said):
    with pytest.raises(ValidationError, match=said):
        options(**changes)


class Registers:
    """A ``Link`` to slaves in this process."""

    name, is_ring = "ethercat test", False

    def __init__(self, slaves):
        self.slaves = slaves

    def write(self, command, slave, register, data):
        return self.slaves.send(command, (slave, register), data)

    def station_read(self, station, register, length):
        return self.slaves.send(FPRD, (station, register), bytes(length)).data

    def station_write(self, station, register, data):
        assert self.slaves.send(FPWR, (station, register), data).wkc == 1


def synced(slaves):
    """The first slave in PREOP, all but SYNC0 set for more."""
    slaves.operate()
    slaves.ask(PREOP)
    return Registers(slaves)


def test_sync0_begins_on_the_grid_of_whole_periods():
    slaves = Slaves()
    link = synced(slaves)
    begin_sync0(link, 0x1001, "amplifier", PERIOD_NS, SHIFT_NS)
    (start_ns,) = struct.unpack("<q", link.station_read(0x1001, DC_START, 8))
    (now_ns,) = struct.unpack("<q", link.station_read(0x1001, DC_SYSTEM, 8))
    assert start_ns % PERIOD_NS == SHIFT_NS
    assert 0 < start_ns - now_ns <= 1e9 * SYNC0_BEGINS_IN_S + SHIFT_NS
    assert struct.unpack("<I", link.station_read(0x1001, DC_SYNC0_CYCLE, 4)) == (PERIOD_NS,)
    assert link.station_read(0x1001, DC_ACTIVATE, 1)[0] == SYNC_ON | SYNC0_ON
    assert slaves.ask(SAFEOP) == (SAFEOP, 0)
    assert slaves.ask(OP) == (SAFEOP | ERROR, NO_SYNC), "it has not begun"
    slaves.now_ns += round(2e9 * SYNC0_BEGINS_IN_S)
    assert slaves.ask(OP | ERROR) == (OP, 0)


@pytest.mark.compiled_only
def test_the_way_through_the_line_is_no_error_of_the_clock():
    """A frame that is 3 us on its way there, 30 us in the line, as its ports have told, and 3 us on its way back."""
    driver = Ethercat(options(lock=LOCK), PERIOD_NS)
    c = driver.record(driver.context())
    ahead_ns, sent_ns, data = 7 * 10**17, 10**12, np.zeros(1472, np.uint8)
    stamp = struct.pack("<qH", sent_ns + 3_000 + ahead_ns, 2)
    data[c["time_at"] : c["time_at"] + len(stamp)] = np.frombuffer(stamp, np.uint8)
    c["gate"]["sent_count"], c["lock"]["sent_ns"][0], c["turn_ns"] = 1, sent_ns, 30_000
    exchange.hear_first_clock(c, data, 0, sent_ns + 36_000)
    lock = c["lock"]
    assert int(lock["apart_ns"]) + (lock["lowest_ns"] + lock["highest_ns"]) / 2 == ahead_ns


def test_the_filters_of_the_drift_compensation_begin_anew():
    """The slave's value for it is written back, which empties them (ETG.1000.4, register 0x0930)."""
    slaves, written = Slaves(), []
    link = synced(slaves)
    link.station_write = lambda station, register, data: written.append((station, register, data))
    set_clocks(link, [0x1001, 0x1002])
    for station in (0x1001, 0x1002):
        assert [each[1] for each in written if each[0] == station] == [DC_OFFSET, DC_DELAY, DC_SPEED_START]
        assert written[-1][2] == b"\x00\x10"


@pytest.mark.parametrize(
    ("is_ring", "without", "said"),
    [
        (False, 0, "terminal amplifier has no clock: the first, which the others would follow"),
        (False, 1, None),
        (True, 1, "terminal gauge has no clock: a ring's clocks need one in each"),
    ],
)
def test_clocks_that_nobody_could_lead_are_refused(is_ring, without, said):
    """Who is asked for the time and has none would let all others be told zero."""
    slaves = Slaves()
    link = synced(slaves)
    slaves.line.applications[without].memory[FEATURES] = 0
    stations, names = [0x1001, 0x1002], ["amplifier", "gauge"]
    clocks = set_clocks(link, stations)
    link.is_ring = is_ring
    with pytest.raises(DeviceFault, match=said) if said else contextlib.nullcontext():
        require_clocks(link, clocks, stations, names)


@pytest.fixture(scope="module")
def ends():
    with veth("ecc") as ends:
        yield ends


@pytest.mark.live
@pytest.mark.compiled_only
@pytest.mark.xdist_group("ethercat")
def test_the_deadlines_lock_to_a_clock_that_drifts_and_the_outputs_wait_for_it(ends):
    with Bench(ends, lock=LOCK, **SYNCED) as bench:
        first = bench.line.controllers[0]
        bench.line.applications[0].drift(0.0, bench.now_ns)
        system_ns(first, bench.now_ns)  # compiled before a frame waits for it
        bench.open()
        bench.by_the_clock, bench.now_ns = True, time.monotonic_ns()
        bench.line.applications[0].drift(60.0, bench.now_ns)
        codes = []
        patiently(lambda: codes.append(bench.exchange(0.0, 1.0)) or codes[-1] == 0)
        assert bench.statistics["locked"] == 1
        assert bench.c["turn_ns"] == 1500, "as the first terminal's ports have told"
        assert TAKEN in codes, "the line was up, and the outputs waited for the clock"

        def beyond_ns():
            """By how much the error is more than what the frames leave open, and the lock allows."""
            bench.exchange(0.0, 1.0)
            half, lock = PERIOD_NS // 2, bench.c["lock"]
            late_ns = (int(system_ns(first, bench.now_ns)) + half) % PERIOD_NS - half
            return abs(late_ns) - (lock["highest_ns"] - lock["lowest_ns"]) / 2 - abs(lock["error_ns"])

        assert max(beyond_ns() for _ in range(300)) < 2_000
        bench.line.applications[0].drift(900.0, bench.now_ns)
        patiently(lambda: bench.exchange(0.0, 1.0) == DOWN)
        assert (bench.statistics["unlocked"], bench.statistics["losses"]) == (1, 1)


def patiently(true):
    """Until it is, also on a machine that stalls."""
    end = time.monotonic() + 60.0
    while not true():
        assert time.monotonic() < end
