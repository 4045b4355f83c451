"""Reading as on SocketCAN, from a datagram socket in its place: time stamps and the overflow counter are the same."""

import socket
import struct
import time

import pytest
from micromanip_drivers.canbus.socketcan import KernelReader


@pytest.fixture
def pair():
    with (
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as receiver,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender,
    ):
        receiver.bind(("127.0.0.1", 0))
        sender.connect(receiver.getsockname())
        yield sender, receiver


def classic(word, data):
    return struct.pack("=IB3x8s", word, len(data), data)


def fd(word, flags, data):
    return struct.pack("=IBB2x64s", word, len(data), flags, data)


def test_frames_are_what_the_kernel_says(pair):
    sender, receiver = pair
    reader = KernelReader(receiver)
    for packet in (
        classic(0x123, b"ab"),
        classic(0x80000123, b""),
        fd(0x101, 1, bytes(24)),
        classic(0x20000040, bytes(8)),
    ):
        sender.send(packet)
    messages = [message for message, _ in reader.drain(10)]
    assert [
        (m.arbitration_id, m.is_extended_id, m.is_fd, m.bitrate_switch, m.is_error_frame, m.dlc) for m in messages
    ] == [
        (0x123, False, False, False, False, 2),
        (0x123, True, False, False, False, 0),
        (0x101, False, True, True, False, 24),
        (0x040, False, False, False, True, 8),
    ]
    assert messages[0].data == b"ab"
    assert reader.drain(10) == []


@pytest.mark.parametrize("step_s", [3600, -3600, 1e9])
def test_a_stepped_wall_clock_leaves_the_time_between_last_look_and_now(pair, monkeypatch, step_s):
    sender, receiver = pair
    reader = KernelReader(receiver)
    look_ns = time.monotonic_ns()
    reader.drain(1)
    real = time.time_ns
    monkeypatch.setattr(time, "time_ns", lambda: real() + round(step_s * 1e9))
    sender.send(classic(1, b""))
    [(_, time_ns)] = reader.drain(10)
    assert look_ns <= time_ns <= time.monotonic_ns()


def test_frames_keep_their_order_in_time_over_a_step_of_the_wall_clock(pair, monkeypatch):
    sender, receiver = pair
    reader = KernelReader(receiver)
    reader.drain(1)
    sender.send(classic(1, b""))
    sender.send(classic(2, b""))
    real, reads = time.time_ns, iter((-3600, 0))  # as if the clock had been set back between the two frames
    monkeypatch.setattr(time, "time_ns", lambda: real() + next(reads) * 1_000_000_000)
    time.sleep(0.01)
    [(_, first_ns), (_, second_ns)] = reader.drain(2)
    assert first_ns <= second_ns <= time.monotonic_ns()


def test_frames_that_did_not_fit_are_counted(pair):
    sender, receiver = pair
    receiver.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 2048)
    reader = KernelReader(receiver)
    for _ in range(200):
        sender.send(classic(1, b""))
    kept = len(reader.drain(500))
    sender.send(classic(2, b""))  # the counter comes with the next frame
    assert len(reader.drain(500)) == 1
    assert 0 < kept < 200
    assert reader.overflows == 200 - kept
