"""Devices on a bus of python-can: here the test bus, which a hub in another thread keeps."""

import os
import queue
import time

import pytest
from drivers.canbus.hub_in_thread import bench

from micromanip.emulation.can.can_bus import PythonCanBus
from micromanip.errors import DeviceUnavailable
from micromanip.testbus.event_loop import EventLoop
from micromanip.testbus.frame import Frame

CHANNEL = f"foreign-{os.getpid()}"


class Node:
    def __init__(self, loop):
        self.loop, self.heard = loop, []

    def on_frame(self, frame, time_ns):
        self.heard.append(frame)
        self.loop.stop()


@pytest.fixture
def loop():
    loop = EventLoop()
    yield loop
    loop.close()


def wait(loop):
    loop.run(time.monotonic_ns() + 10_000_000_000)


def test_frames_go_both_ways_and_are_counted(loop):
    with bench(CHANNEL) as at:
        bus, node = PythonCanBus(loop, "micromanip", CHANNEL, 1_000_000, 5_000_000), Node(loop)
        bus.attach(node)
        sent = Frame(0x101, bytes(range(24)), fd=True, bitrate_switch=True)
        assert bus.send(node, sent, 0)
        assert at.device.heard.get(timeout=10)[0] == sent
        at.send(0x1ABCDEF, b"\x01\x02", extended=True)
        wait(loop)
        assert node.heard == [Frame(0x1ABCDEF, b"\x01\x02", extended=True)]
        assert bus.statistics.frames == 2
        assert 100_000 < bus.statistics.busy_ns < 300_000
        bus.detach(node)
        at.send(0x100, b"")
        loop.run(time.monotonic_ns() + 20_000_000)
        assert len(node.heard) == 1
        bus.close()
        with pytest.raises(queue.Empty):
            at.device.heard.get_nowait()


def test_bus_that_goes_away_ends_the_loop_with_a_sentence(loop):
    with bench(CHANNEL) as at:
        bus = PythonCanBus(loop, "micromanip", CHANNEL, 1_000_000, 5_000_000)
        at.do(at.hub.close)
        with pytest.raises(DeviceUnavailable, match="is gone: "):
            wait(loop)
        assert not bus.send(Node(loop), Frame(1))
        bus.close()
