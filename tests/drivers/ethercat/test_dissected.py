"""What our own master says on the wire, as tshark reads it: on a line that is lost once, and at both ends of a ring."""

import shutil
import time
from dataclasses import replace
from itertools import pairwise

import pytest
from micromanip_drivers.ethercat.link import Link
from micromanip_drivers.ethercat.mailbox import Mailbox
from micromanip_drivers.ethercat.scan import found

from micromanip.emulation.ethercat.terminal import INPUTS, MAILBOX_BYTES, MAILBOX_IN, MAILBOX_OUT, OUTPUTS
from tests.emulation.ethercat.wire import veth

from .bench import SILENT_CYCLES, Bench
from .recorded import AMISS, Recorded, dissected
from .test_clocks import LOCK, SHIFT_NS, SYNCED
from .test_ring import TERMINALS, cut

pytestmark = [
    pytest.mark.live,
    pytest.mark.thorough,  # the slaves' side of it is dissected in tests/emulation/ethercat
    pytest.mark.compiled_only,
    pytest.mark.xdist_group("ethercat"),
    pytest.mark.skipif(shutil.which("tshark") is None, reason="needs tshark"),
]

LONG = bytes(range(256)) + bytes(44)
ASKED, ANSWERED = "eth.src == 10:10:10:10:10:11", "eth.src == 12:10:10:10:10:11"
FPWR, NOP = "5", "ecat.sub1.cmd == 0"


@pytest.fixture(scope="module")
def line(tmp_path_factory):
    """A line with a clock to lock to is brought up, works, loses frames, is lost, and comes back; objects are read."""
    file = tmp_path_factory.mktemp("line") / "line.pcap"
    with veth("ecl") as ends, Recorded(ends[0], file), Bench(ends, lock=LOCK, **SYNCED) as bench:
        amplifier = bench.line.applications[0]
        settings = amplifier.terminal.settings | {(0x8001, 1): LONG}
        amplifier.become(replace(amplifier.terminal, settings=settings), time.monotonic_ns())
        bench.line.relink()
        bench.open()
        for _ in range(30):
            bench.exchange(0.0, 1.0)
        bench.meddle = lambda _: []
        for _ in range(2 * SILENT_CYCLES):
            bench.exchange(0.0, 1.0)
        bench.meddle = lambda frame: [frame]
        for _ in range(30):
            bench.exchange(0.0, 1.0)
        with Link(ends[0]) as link:
            mailbox = Mailbox(link, next(found(link)), "amplifier")
            assert mailbox.read(0x8001, 1) == LONG
            assert len(mailbox.read(0x1018, 0, complete=True)) == 18
            mailbox.write(0x8001, 1, LONG)
    return file


@pytest.fixture(scope="module")
def ring(tmp_path_factory):
    """The two ends of a ring that is whole, cut, and whole again."""
    folder = tmp_path_factory.mktemp("ring")
    with veth("ecn") as near, veth("ecm") as far:
        files = [folder / "near.pcap", folder / "far.pcap"]
        recorded = Recorded(near[0], files[0]), Recorded(far[0], files[1])
        with recorded[0], recorded[1], Bench(near, step_V=1.0, far_ends=far, terminals=TERMINALS) as bench:
            bench.open().follow()
            for places in ((), (1,), ()):
                cut(bench, *places)
                for _ in range(20):
                    bench.exchange(0.5, 0.0)
    return files


def written(file, register, *fields):
    """What the first terminal let be written there, each time."""
    only = f"{ANSWERED} && ecat.cmd == {FPWR} && ecat.adp == 0x1001 && ecat.ado == {register} && ecat.cnt == 1"
    return [tuple(int(row[field], 0) for field in fields) for row in dissected(file, *fields, only=only)]


def test_nothing_is_amiss_on_a_line(line):
    assert dissected(line, "frame.number", only=AMISS) == []
    assert len(dissected(line, "frame.number", only=NOP)) > 100
    assert dissected(line, "ecat.cnt", only=f"{ASKED} && ecat.cnt != 0") == [], "no counter is sent ahead"


def test_the_mailboxes_counter_goes_from_1_to_7(line):
    """It begins anew where a mailbox is opened anew."""
    only = f"{ASKED} && ecat.cmd == {FPWR} && ecat_mailbox"
    rows = dissected(line, "ecat.adp", "ecat_mailbox.counter", only=only)
    of_first = [int(row["ecat_mailbox.counter"]) for row in rows if row["ecat.adp"] == "0x1001"]
    assert len(of_first) > 10
    assert set(of_first) == set(range(1, 8))
    assert all(after in (1, before % 7 + 1) for before, after in pairwise(of_first))


def test_sync_managers_fmmus_and_watchdog_are_laid_out_as_ETG_1000_4_says(line):
    managers = {
        0x800: (MAILBOX_OUT, MAILBOX_BYTES, 0x26),  # one buffer, the master writes, an event for the slave
        0x808: (MAILBOX_IN, MAILBOX_BYTES, 0x22),  # one buffer, the master reads
        0x810: (OUTPUTS, 5, 0x64),  # three buffers, the master writes, feeds the watchdog
        0x818: (INPUTS, 1, 0x20),  # three buffers, the master reads
    }
    keys = [f"ecat.syncman.{each}" for each in ("start", "len", "ctrlstatus", "smenable")]
    for register, (start, length, control) in managers.items():
        assert set(written(line, register, *keys)) == {(start, length, control, 1)}
    parts = [f"ecat.fmmu.{each}" for each in ("lstart", "llen", "lstartbit", "lendbit", "type", "activate")]
    assert set(written(line, 0x600, *parts)) == {(0, 5, 0, 7, 2, 1)}
    assert set(written(line, 0x610, *parts)) == {(5, 1, 0, 7, 1, 1)}
    assert set(written(line, 0x400, "ecat.reg.wd.divisor")) == {(2498,)}
    assert set(written(line, 0x420, "ecat.reg.wd.timesm")) == {(10_000,)}, "1000 ms in units of 100 us"


def test_clocks_are_set_in_their_order_and_told_the_time_in_each_cycle(line):
    dc = [int(row["ecat.ado"], 0) for row in dissected(line, "ecat.ado", only=f"{ASKED} && ecat.ado >= 0x900")]
    begun = [register for register in dc if register < 0x1000][1:]  # SYNC is off first
    measured, set_up = [0x900, *2 * [0x900], *2 * [0x918]], 2 * [0x920, 0x928, 0x930, 0x930]
    assert begun[: len(measured) + len(set_up)] == measured + set_up
    assert begun[len(measured) + len(set_up) :][:6] == [0x981, 0x980, 0x910, 0x990, 0x9A0, 0x981]
    (start,) = set(written(line, 0x9A0, "ecat.reg.dc.cyctime0"))
    assert start == (100_000,)
    assert {time_ns % 100_000 for (time_ns,) in written(line, 0x990, "ecat.reg.dc.starttime0")} == {SHIFT_NS}
    for row in dissected(line, "ecat.sub4.cmd", "ecat.sub4.adp", "ecat.sub4.ado", "ecat.sub4.cnt", only=NOP):
        command, position, register, counter = (int(each, 0) for each in row.values())
        assert (command, register) == (13, 0x910), "ARMW of the system time"
        assert (position, counter) in ((0, 0), (2, 2)), "as it was sent; read by one, written by the other"


def test_a_ring_reads_well_at_both_ends(ring):
    """Whole, what is sent at one end comes in at the other; cut, each half comes back with its terminals' counters."""
    seen = []
    for file in ring:
        assert dissected(file, "frame.number", only=AMISS) == []
        rows = dissected(file, "eth.src", "ecat.sub3.cnt", "ecat.sub4.adp", only=NOP)
        seen.append({tuple(row.values()) for row in rows})
    near, far = seen
    passed = ("12:10:10:10:10:10", "3", "0x0003"), ("10:10:10:10:10:12", "0", "0x0000")
    assert passed[0] in far - near
    assert passed[1] in near & far, "what was sent at the far end goes by behind the terminals"
    assert ("12:10:10:10:10:10", "1", "0x0001") in near - far
    assert ("12:10:10:10:10:12", "2", "0x0002") in far - near
