"""Garbage on the driver's own identifiers, and being opened again and again."""

import pytest

from .cell import cell, run

pytestmark = pytest.mark.live  # it waits for what never comes

PARK = (0.0, 0.0, 0.0)


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
