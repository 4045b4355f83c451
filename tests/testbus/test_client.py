"""The python-can interface on a bus in virtual time: what a driver meets that is written against SocketCAN."""

import errno
import socket
from types import SimpleNamespace

import can
import pytest

from micromanip.bus.can_bits import classic_bits
from micromanip.testbus.client import HubBus
from micromanip.testbus.client_port import address
from micromanip.testbus.frame import Frame

from .virtual_bus import message, received, sent_until_refused


@pytest.mark.parametrize(
    "sent",
    [
        message(0x123, b"\x01\x02\x03"),
        message(0x1ABCDEF0, b"\xff" * 8, is_extended_id=True),
        message(0x7FF, is_remote_frame=True, dlc=4),
        message(0x5, bytes(range(64)), is_fd=True, bitrate_switch=True),
        message(0x5, bytes(range(12)), is_fd=True),
    ],
    ids=["standard", "extended", "remote", "fd", "fd without bit rate switch"],
)
def test_a_frame_arrives_as_it_was_sent(make_bus, sent):
    bus = make_bus(1_000_000, 5_000_000)
    a, b = bus.client(fd=True), bus.client(fd=True)
    a.send(sent)
    bus.run(0.001)
    got = b.recv(0)
    assert got.equals(sent, timestamp_delta=None, check_channel=False, check_direction=False)
    assert got.channel == bus.channel
    assert got.is_rx


def test_clients_and_nodes_take_part_in_the_same_arbitration(bus):
    node, a, b, listener = bus.node(), bus.client(), bus.client(), bus.client()
    bus.hub.send(node, Frame(0x700))
    a.send(message(0x300))
    b.send(message(0x200))
    bus.hub.send(node, Frame(0x250))
    bus.run(0.001)
    assert [frame.arbitration_id for frame in received(listener)[0]] == [0x700, 0x200, 0x250, 0x300]
    assert node.identifiers == [0x200, 0x300]


def test_a_client_without_fd_does_not_see_fd_frames_nor_send_them(make_bus):
    bus = make_bus(1_000_000, 5_000_000)
    a, b = bus.client(fd=True), bus.client()
    a.send(message(1, is_fd=True))
    a.send(message(2))
    bus.run(0.001)
    assert [frame.arbitration_id for frame in received(b)[0]] == [2]
    with pytest.raises(can.CanOperationError, match="without fd") as refused:
        b.send(message(is_fd=True))
    assert refused.value.error_code == errno.EINVAL
    assert (a.protocol, b.protocol) == (can.CanProtocol.CAN_FD, can.CanProtocol.CAN_20)


def test_a_hub_that_does_not_answer_is_given_up():
    with socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as dead:
        dead.bind(address("dead"))
        dead.listen()
        with pytest.raises(can.CanInitializationError, match="does not answer"):
            HubBus("dead")


@pytest.mark.parametrize(
    ("rates", "options", "said"),
    [
        ((1_000_000,), {"bitrate": 500_000}, "bitrate of 1000000, not 500000"),
        ((1_000_000, 5_000_000), {"fd": True, "data_bitrate": 2_000_000}, "data_bitrate of 5000000, not 2000000"),
        ((1_000_000,), {"fd": True}, "no CAN FD"),
    ],
)
def test_another_bus_than_asked_for_is_refused(make_bus, rates, options, said):
    bus = make_bus(*rates)
    bus.client(bitrate=1_000_000)
    refused = []

    def open_it():
        with pytest.raises(can.CanInitializationError, match=said):
            HubBus(bus.channel, **options)
        refused.append(True)

    bus.call(open_it)
    assert refused


def test_who_sends_faster_than_the_bus_is_refused_and_nothing_that_was_taken_is_lost(bus):
    a, b = bus.client(), bus.client()
    bus.hub.send(bus.node(), Frame(0))
    taken, error = sent_until_refused(a)
    bus.run(0)
    more, _ = sent_until_refused(a)  # the hub has taken what its queue holds: there is room in the socket again
    assert error.error_code == errno.ENOBUFS
    assert more > 0
    assert sent_until_refused(a)[0] == 0
    with pytest.raises(can.CanOperationError, match="full"):
        a.send(message(), timeout=0.001)
    bus.run(0.01)
    assert [frame.data[0] for frame in received(b)[0] if frame.data] == [*range(taken), *range(more)]
    a.send(message())


def test_a_hub_that_comes_late_loses_nothing_and_gives_each_frame_its_own_time(bus, monkeypatch):
    """The machine had no time for it, for 20 ms: a bus would have carried them, and the nodes would have measured."""
    client, begin_ns = bus.client(), bus.loop.time_ns
    seen = []
    node = SimpleNamespace(on_frame=lambda frame, time_ns: seen.append((time_ns - begin_ns, frame.data[0])))
    bus.hub.attach(node)
    for count in range(20):
        sent_ns = begin_ns + count * 1_000_000
        monkeypatch.setattr("micromanip.testbus.client.time", SimpleNamespace(monotonic_ns=lambda ns=sent_ns: ns))
        client.send(message(data=bytes([count])))
        timer_ns = sent_ns + 500_000
        bus.loop.call_at(timer_ns, lambda ns=timer_ns: seen.append((ns - begin_ns, "timer")))
    bus.loop.time_ns += 20_000_000
    bus.run(0)
    frame_ns = classic_bits(1) * 1000
    expected = [((k * 1_000_000 + frame_ns, k), (k * 1_000_000 + 500_000, "timer")) for k in range(20)]
    assert seen == [each for pair in expected for each in pair]


def test_who_does_not_read_loses_frames_and_is_told(make_bus):
    bus = make_bus(queue_frames=2000)
    node, slow, quick = bus.node(), bus.client(), bus.client()
    process_port = next(iter(bus.hub.clients))
    for number in range(1000):
        bus.hub.send(node, Frame(0x100, number.to_bytes(2, "little")))
    got = []
    for _ in range(1000):
        bus.run(classic_bits(2) * 1e-6)
        got += received(quick)[0]
    assert [int.from_bytes(frame.data, "little") for frame in got] == list(range(1000))
    frames, errors = received(slow)
    assert [int.from_bytes(frame.data, "little") for frame in frames] == list(range(len(frames)))
    assert len(frames) + process_port.dropped == 1000
    assert process_port.dropped > 0
    assert errors == []  # there was no room for it either
    bus.hub.send(node, Frame(0x101))
    bus.hub.send(node, Frame(0x102))
    bus.run(0.001)
    frames, errors = received(slow)
    assert [frame.arbitration_id for frame in frames] == [0x101, 0x102]
    assert [(error.arbitration_id & 0x4, error.data[1]) for error in errors] == [(0x4, 0x01)]


@pytest.mark.parametrize("packet", [b"x", bytes(23), bytes(8) + bytes(4) + b"\x09" + bytes(11), bytes(80)])
def test_who_speaks_another_language_is_shown_the_door(bus, packet):
    """The last one is an FD frame, which this bus can't carry."""
    client, stranger, node = bus.client(), socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET), bus.node()
    with stranger:
        stranger.connect(address(bus.channel))
        stranger.send(packet)
        bus.run(0.001)
        stranger.settimeout(0)
        assert stranger.recv(4096).startswith(b"{")
        assert stranger.recv(4096) == b""
    client.send(message(7))
    bus.run(0.001)
    assert node.identifiers == [7]
