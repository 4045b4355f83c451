"""Error counters, error-passive and bus-off: what ISO 11898-1 counts, and what a client is told as by SocketCAN."""

import can
import pytest

from micromanip.bus.can_bits import classic_bits
from micromanip.testbus.faults import BusOff, Corrupt, ErrorPassive
from micromanip.testbus.frame import Frame

from .virtual_bus import message, received

CONTROLLER, PROTOCOL, BUS_OFF, BUS_ERROR, RESTARTED = 0x004, 0x008, 0x040, 0x080, 0x100
RX_WARNING, TX_WARNING, RX_PASSIVE, TX_PASSIVE, ACTIVE = 0x04, 0x08, 0x10, 0x20, 0x40


def told(errors):
    """What error frames say, without those of single bus errors."""
    said = []
    for error in errors:
        if error.arbitration_id & CONTROLLER:
            said.append(error.data[1])
        elif error.arbitration_id in (BUS_OFF, RESTARTED):
            said.append({BUS_OFF: "bus-off", RESTARTED: "restarted"}[error.arbitration_id])
    return said


def test_a_destroyed_frame_is_sent_again_until_it_arrives(bus):
    a, b = bus.client(), bus.node()
    bus.hub.faults.inject(Corrupt(share=1.0, for_s=0.0004))
    a.send(message(0x10, bytes(8)))
    bus.run(0.002)
    frames, errors = received(a)
    assert frames == []
    assert [error.arbitration_id for error in errors] == [PROTOCOL | BUS_ERROR] * 2
    assert errors[0].data[2] & 0x80  # on transmission
    assert b.times_ns == [(3 * classic_bits(8) + 2 * 23) * 1000]
    assert bus.hub.statistics.destroyed == 2
    assert bus.hub.statistics.busy_ns == b.times_ns[0]


def test_who_never_gets_through_becomes_passive_then_bus_off(bus):
    sender, listener = bus.client(), bus.client()
    bus.hub.faults.inject(Corrupt(share=1.0))
    sender.send(message())
    bus.run(0.01)
    assert told(received(sender)[1]) == [TX_WARNING, TX_PASSIVE, "bus-off"]
    assert bus.hub.statistics.destroyed == 32  # 8 for each: 256
    with pytest.raises(can.CanOperationError, match="bus-off"):
        sender.send(message())
    assert told(received(listener)[1]) == []  # 32 receive errors don't make a warning


def test_receivers_count_single_errors_and_recover_by_what_they_receive(bus):
    """Four senders go bus-off one after the other; those who listen count to 128 and become passive."""
    senders, listener = [bus.client() for _ in range(4)], bus.client()
    bus.hub.faults.inject(Corrupt(share=1.0, for_s=0.02))
    for sender in senders:
        sender.send(message())
    bus.run(0.02)
    assert told(received(listener)[1]) == [RX_WARNING, RX_PASSIVE]
    node = bus.node()
    bus.hub.send(node, Frame(1))
    bus.run(0.001)
    assert told(received(listener)[1]) == [RX_WARNING]


def test_a_bus_off_client_neither_hears_nor_sends_until_it_connects_again(bus):
    client, node, other = bus.client(), bus.node(), bus.node()
    bus.hub.send(other, Frame(5))
    bus.hub.faults.inject(BusOff())
    client.send(message(6))  # it doesn't know yet
    bus.run(0.01)
    frames, errors = received(client)
    assert frames == []
    assert told(errors) == ["bus-off"]
    assert node.identifiers == [5]
    client.shutdown()
    client = bus.client()
    client.send(message(7))
    bus.hub.send(other, Frame(8))
    bus.run(0.01)
    assert [frame.arbitration_id for frame in received(client)[0]] == [8]
    assert node.identifiers == [5, 7, 8] or node.identifiers == [5, 8, 7]
    assert len(list(bus.hub.clients)) == 1


def test_error_passive_lasts_as_long_as_it_is_told_and_then_wears_off_with_what_is_sent(bus):
    client, node = bus.client(), bus.node()
    bus.hub.faults.inject(ErrorPassive(for_s=0.002))
    for _ in range(3):
        client.send(message())
    bus.run(0.001)
    assert told(received(client)[1]) == [TX_PASSIVE]
    bus.run(0.002)
    for _ in range(40):
        client.send(message())
        bus.run(0.0001)
    assert told(received(client)[1]) == [TX_WARNING, ACTIVE]
    assert len(node.got) == 43


def test_a_client_that_left_with_a_frame_that_never_gets_through_is_forgotten(bus):
    client = bus.client()
    bus.hub.faults.inject(Corrupt(share=1.0))
    client.send(message())
    client.send(message())
    client.shutdown()
    bus.run(0.01)
    destroyed = bus.hub.statistics.destroyed
    bus.run(0.01)
    assert bus.hub.statistics.destroyed == destroyed <= 64
