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
from .test_clocks import LOCK, SYNCED
from .test_ring import TERMINALS, cut

pytestmark = [
    pytest.mark.live,
    pytest.mark.thorough,  # the slaves' side of it is dissected in tests/emulation/ethercat
    pytest.mark.compiled_only,
    pytest.mark.xdist_group("ethercat"),
    pytest.mark.skipif(shutil.which("tshark") is None, reason="needs tshark"),
]

LONG = bytes(range(1, 9))
ASKED, ANSWERED = "eth.src == 10:10:10:10:10:11", "eth.src == 12:10:10:10:10:11"
FPWR, NOP = "5", "ecat.sub1.cmd == 0"


@pytest.fixture(scope="module")
def line(tmp_path_factory):
    """A line with a clock to lock to is brought up, works, loses frames, is lost, and comes back; objects are read."""
    file = tmp_path_factory.mktemp("line") / "line.pcap"
    with veth("ecl") as ends, Recorded(ends[0], file), Bench(ends, lock=LOCK, **SYNCED) as bench:
        amplifier = bench.line.applications[0]
        settings = amplifier.terminal.settings | {(0x8001, 1): bytes(8)}
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
            mailbox.write(0x8001, 1, LONG)
            assert mailbox.read(0x8001, 1) == LONG
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
