"""Bit time and arbitration, in virtual time: what a bus of real bits would do."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from micromanip.bus.can_bits import classic_bits, fd_bits
from micromanip.testbus.frame import Frame

from .virtual_bus import BEGIN_NS, VirtualBus, message

US = 1000


def test_a_frame_arrives_when_its_last_bit_has_gone_out(bus):
    sender, listener = bus.node(), bus.node()
    assert bus.hub.send(sender, Frame(0x100, bytes(8)))
    bus.run(0.001)
    assert listener.got == [(classic_bits(8) * US, Frame(0x100, bytes(8)))]
    assert sender.got == []


def test_an_fd_frame_switches_its_bit_rate(make_bus):
    bus = make_bus(1_000_000, 5_000_000)
    sender, listener = bus.node(), bus.node()
    bus.hub.send(sender, Frame(1, bytes(24), fd=True, bitrate_switch=True))
    bus.hub.send(sender, Frame(2, bytes(24), fd=True))
    bus.run(0.001)
    nominal, data = fd_bits(24)
    first_ns = nominal * US + data * US // 5
    assert listener.times_ns == [first_ns, first_ns + (nominal + data) * US]


def test_the_lowest_identifier_goes_first_when_the_bus_gets_idle(bus):
    a, b, c, listener = (bus.node() for _ in range(4))
    bus.hub.send(a, Frame(0x700))  # the bus is idle: it gets it at once, and keeps it
    bus.hub.send(a, Frame(0x001))  # second in its queue, the bus doesn't see it before the first is gone
    bus.hub.send(b, Frame(0x300))
    bus.hub.send(c, Frame(0x200))
    bus.run(0.001)
    assert listener.identifiers == [0x700, 0x001, 0x200, 0x300]


@given(
    st.lists(st.tuples(st.integers(0, 3), st.integers(0, 0x7FF), st.integers(0, 8), st.integers(0, 500)), max_size=40)
)
def test_the_bus_is_never_loaded_more_than_fully(plan):
    """Whatever is sent: frames don't overlap, none is lost or made up, and none that waited lost to a higher one."""
    bus = VirtualBus(queue_frames=100)
    try:
        nodes, listener = [bus.node() for _ in range(4)], bus.node()
        sent = []
        for who, identifier, length, at_us in plan:
            frame = Frame(identifier, bytes(length))
            sent.append(frame)
            send = lambda node=nodes[who], frame=frame: bus.hub.send(node, frame)  # noqa: E731
            bus.loop.call_at(BEGIN_NS + at_us * US, send)
        bus.run(0.01)
        begins = [end_ns - classic_bits(len(frame.data)) * US for end_ns, frame in listener.got]
        assert all(begin >= end for begin, end in zip(begins[1:], listener.times_ns, strict=False))
        assert sorted(listener.identifiers) == sorted(frame.identifier for frame in sent)
        assert bus.hub.statistics.busy_ns == sum(classic_bits(len(frame.data)) * US for frame in sent)
        assert bus.hub.statistics.frames == len(sent)
    finally:
        bus.close()


def test_a_loop_that_woke_late_works_off_what_happened_at_the_time_it_happened(bus):
    sender, listener = bus.node(), bus.node()
    for identifier in (1, 2, 3):
        bus.hub.send(sender, Frame(identifier))
    bus.loop.time_ns += 150 * US  # it slept on
    bus.run(0.001)
    assert listener.times_ns == [55 * US, 110 * US, 165 * US]


def test_a_frame_that_was_not_there_yet_takes_no_part_in_an_arbitration_that_is_worked_off_late(bus):
    a, b, c, listener = (bus.node() for _ in range(4))
    bus.hub.send(a, Frame(0x001))
    bus.loop.time_ns += 300 * US  # it slept on
    bus.hub.send(b, Frame(0x700), BEGIN_NS + 20 * US)
    bus.hub.send(c, Frame(0x100), BEGIN_NS + 200 * US)
    bus.run(0.001)
    assert listener.identifiers == [0x001, 0x700, 0x100]
    assert listener.times_ns == [55 * US, 110 * US, 255 * US]


def test_an_answer_from_a_callback_is_as_of_the_frame_it_answers_however_late_the_loop(bus):
    class Echo:
        def on_frame(self, frame, time_ns):
            bus.hub.send(self, Frame(frame.identifier + 1))

    asker = bus.node()
    bus.hub.attach(Echo())
    bus.hub.send(asker, Frame(0x10))
    bus.loop.time_ns += 5000 * US
    bus.run(0.001)
    assert asker.times_ns == [110 * US]


def test_a_clients_frame_waits_for_the_timers_that_were_due_before_it(bus):
    """A node has fallen 5 ms behind its 500 us timer: the newer frame of a client doesn't push all of them together."""
    node, listener, client = bus.node(), bus.node(), bus.client()
    begin_ns = bus.loop.time_ns

    def tick(number):
        bus.hub.send(node, Frame(0x100 + number), begin_ns + number * 500 * US)
        if number < 10:
            bus.loop.call_at(begin_ns + (number + 1) * 500 * US, lambda: tick(number + 1))

    bus.loop.call_at(begin_ns + 500 * US, lambda: tick(1))
    bus.loop.time_ns += 5200 * US
    client.send(message(0x001))
    bus.run(0.001)
    after_us = [round((BEGIN_NS + time_ns - begin_ns) / US) for time_ns in listener.times_ns]
    assert after_us == [500 * number + 55 for number in range(1, 11)] + [5255]
    assert listener.identifiers[-1] == 0x001


@pytest.mark.parametrize("frame", [Frame(1, bytes(9)), Frame(1, bytes(8), fd=True), Frame(0x800)])
def test_what_a_classic_bus_cannot_carry_is_refused(bus, frame):
    sender, listener = bus.node(), bus.node()
    with pytest.raises(ValueError, match=r"classic|bits"):
        bus.hub.send(sender, frame)
    bus.run(0.001)
    assert listener.got == []
