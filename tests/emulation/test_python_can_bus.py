"""Devices on a bus of python-can: here the test bus, which a hub in another thread keeps."""

import os
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


def test_bus_that_goes_away_ends_the_loop_with_a_sentence(loop):
    with bench(CHANNEL) as at:
        bus = PythonCanBus(loop, "micromanip", CHANNEL, 1_000_000, 5_000_000)
        at.do(at.hub.close)
        with pytest.raises(DeviceUnavailable, match="is gone: "):
            wait(loop)
        assert not bus.send(Node(loop), Frame(1))
        bus.close()
