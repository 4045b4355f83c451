"""A frame that had the slave's mail is lost on its way back: it is asked for once more, and taken once."""

import pytest
from micromanip_drivers.ethercat.mailbox import Mailbox
from micromanip_drivers.ethercat.scan import FIRST_STATION, Slave

from micromanip.bus.ethercat.al_states import PREOP
from micromanip.bus.ethercat.registers import FPRD
from micromanip.emulation.ethercat.terminal import MAILBOX_BYTES, MAILBOX_IN, MAILBOX_OUT
from tests.emulation.ethercat.test_line import Bench as Slaves

from .test_clocks import Registers

SLAVE = Slave(FIRST_STATION, 1, 2, 3, 4, (MAILBOX_OUT, MAILBOX_BYTES), (MAILBOX_IN, MAILBOX_BYTES))
RANGE = (0x8000, 1)


class Losing(Registers):
    """A ``Link`` that loses the frames of some fetches, on their way there or back, and sends them again."""

    def __init__(self, slaves, there=(), back=()):
        super().__init__(slaves)
        self.lost, self.fetches, self._there, self._back = 0, 0, there, back

    def read(self, command, slave, register, length):
        self.fetches += 1
        for is_lost, passes in ((self.fetches in self._there, False), (self.fetches in self._back, True)):
            if is_lost:
                self.lost += 1
                if passes:
                    self.slaves.send(command, (slave, register), bytes(length))
        return self.slaves.send(FPRD, (slave, register), bytes(length))


def mailbox(**lost):
    slaves = Slaves().stations().mailboxes()
    assert slaves.ask(PREOP) == (PREOP, 0)
    link = Losing(slaves, **lost)
    return Mailbox(link, SLAVE, "amplifier"), link


@pytest.mark.parametrize("back", [(1,), (2,), (1, 3), (2, 3, 4)])
def test_mail_that_was_fetched_and_lost_is_laid_out_again(back):
    box, link = mailbox(back=back)
    for value in (b"\7\0", b"\3\1"):
        box.write(*RANGE, value)
        assert box.read(*RANGE) == value
    assert link.lost == len(back)


def test_a_fetch_that_never_came_there_is_only_sent_again():
    box, link = mailbox(there=(1, 2))
    box.write(*RANGE, b"\7\0")
    assert box.read(*RANGE) == b"\7\0"
    assert link.fetches == 2


def test_an_answer_to_an_earlier_request_is_passed_over():
    """Of the same object even: to have been written is no answer to being read."""
    box, link = mailbox()
    slaves, sent = link.slaves, []
    write = link.write

    def doubled(command, slave, register, data):
        sent.append(write(command, slave, register, data))
        return sent[-1]

    link.write = doubled
    box.write(*RANGE, b"\7\0")
    again = bytearray(sent[0].data)
    again[5] = 0x73  # by who was master before
    slaves.send(sent[0].command, (FIRST_STATION, MAILBOX_OUT), bytes(again))
    assert box.read(*RANGE) == b"\7\0"
