"""Garbage on the driver's own identifiers, and being opened again and again."""

import random
import time
from pathlib import Path

import pytest

from micromanip.bus.errors import BusError, DeviceFault, IdentityMismatch, LinkError
from micromanip.bus.inbox import Inbox

from .cell import AMPLIFIER, SENSOR, cell, run

pytestmark = pytest.mark.live  # it waits for what never comes

PARK = (0.0, 0.0, 0.0)


def descriptors():
    return len(list(Path("/proc/self/fd").iterdir()))


def test_garbage_raises_what_the_contract_allows_and_nothing_else():
    dice = random.Random(7)
    services = (0x000, 0x080, 0x180, 0x200, 0x280, 0x380, 0x480, 0x580, 0x600, 0x700, 0x7FF)
    with cell() as at:
        bus = at.driver(nodes__amplifier__watchdog_ms=None)
        bus.open()
        raised, inbox = set(), Inbox()
        for _ in range(400):
            identifier = dice.choice(services) + dice.choice((0, SENSOR, AMPLIFIER)) & 0x7FF
            if not identifier:
                continue  # NMT commands are no garbage
            at.at.send(identifier, dice.randbytes(dice.randrange(9)), extended=dice.random() < 0.1)
            try:
                bus.receive(inbox, time.monotonic_ns() + 2_000_000)
            except BusError as problem:
                raised.add(type(problem))
        assert DeviceFault in raised  # an emergency was among it
        bus.close()


def test_stale_and_foreign_answers_do_not_pass_for_ours():
    """Answers about other objects, and about ours to somebody else, come before the right one."""
    with cell() as at:
        node = at.nodes["sensor"]
        send = node._send

        def noisy(service, data):
            if service == 0x580:
                send(service, b"\x43\x99\x99\x01" + bytes(4))
                send(service, b"\x80" + data[1:3] + bytes((data[3] ^ 1,)) + bytes(4))
                send(service, data[:5])
            send(service, data)

        node._send = noisy
        bus = at.driver()
        bus.open()
        run(bus, PARK, lambda samples: len(samples) >= 6)
        bus.close()


@pytest.mark.parametrize("fails", [False, True])
def test_opened_many_times_leaves_nothing_behind(fails):
    with cell() as at:
        changes = {"nodes__sensor__identity": {"serial": 99}} if fails else {}
        bus = at.driver(nodes__sensor__heartbeat_ms=60, nodes__amplifier__heartbeat_ms=60, **changes)
        before = descriptors()
        for _ in range(40):
            try:
                bus.open()
            except IdentityMismatch:
                assert fails
            bus.close()
            bus.close()
        at.do(lambda: None)
        assert descriptors() <= before + 1  # the hub's end of the last one may not be closed yet
        with pytest.raises(LinkError, match="is not open"):
            bus.perform(0, PARK, Inbox())
