"""The slave controllers alone, frame by frame: addressing, working counter, mailboxes, states, clocks."""

import struct

import pytest

from micromanip.bus.ethercat.al_states import (
    OP,
    PREOP,
    SAFEOP,
)
from micromanip.bus.ethercat.frames import Datagram, framed, unframed
from micromanip.bus.ethercat.registers import (
    AL_CONTROL,
    AL_STATUS,
    APWR,
    BRD,
    DC_SYSTEM,
    FMMU,
    FPRD,
    FPWR,
    FRMW,
    SM,
    STATION,
)
from micromanip.emulation.ethercat.line import Line
from micromanip.emulation.ethercat.terminal import INPUTS, MAILBOX_BYTES, MAILBOX_IN, MAILBOX_OUT, OUTPUTS

from .terminals import AMPLIFIER, GAUGE

MS = 1_000_000


class Bench:
    """The line, and a master that says what a test wants; its time goes on with each frame."""

    def __init__(self):
        self.left = 0
        self.line, self.now_ns = Line([AMPLIFIER, GAUGE], self.leave), 1_000 * MS
        for application in self.line.applications:
            application.switch_on(self.now_ns)
        self.line.relink()

    def leave(self):
        self.left += 1

    def send(self, command, address, data):
        """The datagram as it comes back."""
        self.now_ns += 1000
        (back,) = unframed(self.line.passed(framed([Datagram(command, address, data)]), self.now_ns))
        return back

    def stations(self):
        for k in range(2):
            assert self.send(APWR, (-k & 0xFFFF, STATION), struct.pack("<H", 0x1001 + k)).wkc == 1
        return self

    def manage(self, k, start, length, control, station=0x1001):
        self.send(FPWR, (station, SM + 8 * k), struct.pack("<HHBBBB", start, length, control, 0, 1, 0))

    def mailboxes(self):
        for station in (0x1001, 0x1002):
            self.manage(0, MAILBOX_OUT, MAILBOX_BYTES, 0x26, station)
            self.manage(1, MAILBOX_IN, MAILBOX_BYTES, 0x22, station)
        return self

    def ask(self, state, station=0x1001):
        """AL status and code after the state was asked for."""
        self.send(FPWR, (station, AL_CONTROL), struct.pack("<H", state))
        return self.status(station)

    def status(self, station=0x1001):
        return struct.unpack("<H2xH", self.send(FPRD, (station, AL_STATUS), bytes(6)).data)

    def operate(self):
        self.stations().mailboxes()
        assert self.ask(PREOP) == (PREOP, 0)
        self.manage(2, OUTPUTS, 14, 0x64)
        self.manage(3, INPUTS, 2, 0x20)
        for k, (logical, length, start, kind) in enumerate(((0, 14, OUTPUTS, 2), (14, 2, INPUTS, 1))):
            fmmu = struct.pack("<IHBBHBBB3x", logical, length, 0, 7, start, 0, kind, 1)
            self.send(FPWR, (0x1001, FMMU + 16 * k), fmmu)
        assert self.ask(SAFEOP) == (SAFEOP, 0)
        assert self.ask(OP) == (OP, 0)
        return self


def test_the_clocks_follow_the_reference():
    bench = Bench().stations()
    bench.line.controllers[1]["clock_ppb"] = 50_000

    def system(station):
        return struct.unpack("<q", bench.send(FPRD, (station, DC_SYSTEM), bytes(8)).data)[0]

    for _ in range(2000):
        bench.now_ns += MS
        assert bench.send(FRMW, (0x1001, DC_SYSTEM), bytes(8)).wkc == 2
    assert abs(system(0x1002) - system(0x1001) - 1000) < 1500  # 50 ns a ms ahead, of which a 16th is taken each time
    bench.now_ns += 1000 * MS
    assert system(0x1002) - system(0x1001) > 40_000, "left alone it runs away"


@pytest.mark.parametrize("cut", range(1, 28))
def test_a_frame_that_is_cut_off_gives_no_half_datagram(cut):
    frame = framed([Datagram(BRD, (0, 0), bytes(10))])[: 16 + 10 + 10 + 2 - cut]
    assert list(unframed(frame)) == []
