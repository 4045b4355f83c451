"""Several processes on one bus, with python-can's own idioms; bus time is real here."""

import errno
import itertools
import subprocess
import sys
import threading
import time

import can
import pytest

from micromanip.testbus.client import HubBus
from micromanip.testbus.event_loop import EventLoop
from micromanip.testbus.hub import CanHub

from .virtual_bus import message

HUB = """
from micromanip.testbus.hub import CanHub
from micromanip.testbus.event_loop import EventLoop
loop = EventLoop()
hub = CanHub(loop, "{channel}", 1_000_000)
print("ready", flush=True)
loop.run()
"""
ECHO = """
from micromanip.testbus.client import HubBus
import can
with HubBus("{channel}") as bus:
    print("ready", flush=True)
    for message in bus:
        bus.send(can.Message(arbitration_id=message.arbitration_id + 1, data=message.data, is_extended_id=False))
"""


def started(script, channel):
    process = subprocess.Popen(
        [sys.executable, "-c", script.format(channel=channel)], stdout=subprocess.PIPE, text=True
    )
    assert process.stdout.readline() == "ready\n"
    return process


@pytest.fixture
def channel(request):
    """A hub in a thread."""
    name = f"real-{time.monotonic_ns()}"
    loop = EventLoop()
    hub = CanHub(loop, name, 1_000_000)
    thread = threading.Thread(target=loop.run)
    thread.start()
    yield name
    loop.stop()
    thread.join()
    hub.close()
    loop.close()


@pytest.fixture
def end():
    """Processes that are put in here are ended."""
    processes = []
    yield processes
    for process in processes:
        process.kill()
        process.wait()
        process.stdout.close()


def test_a_peer_in_another_process_answers_each_frame(channel, end):
    end.append(started(ECHO, channel))
    with HubBus(channel) as bus:
        stamps = []
        for number in range(100):
            bus.send(message(0x10, number.to_bytes(8, "little")))
            answer = bus.recv(10)
            assert (answer.arbitration_id, int.from_bytes(answer.data, "little")) == (0x11, number)
            stamps.append(answer.timestamp)
    # by the time of the bus, a question and an answer of 135 bits lie between two answers, however fast the machine
    assert min(b - a for a, b in itertools.pairwise(stamps)) >= 270e-6 - 1e-7


def test_periodic_senders_notifiers_and_iteration_work(channel):
    with HubBus(channel) as a, HubBus(channel) as b:
        reader = can.BufferedReader()
        notifier = can.Notifier(b, [reader], timeout=0.05)
        task = a.send_periodic(message(0x77), 0.002)
        got = [reader.get_message(10).arbitration_id for _ in range(5)]
        task.stop()
        notifier.stop()
        assert got == [0x77] * 5


def test_a_killed_hub_is_a_network_that_is_down_and_a_new_one_takes_its_place(end):
    name = f"killed-{time.monotonic_ns()}"
    hub = started(HUB, name)
    end.append(hub)
    with HubBus(name) as bus:
        hub.kill()
        with pytest.raises(can.CanOperationError, match="hub is gone") as down:
            bus.recv(10)
        assert down.value.error_code == errno.ENETDOWN
    with pytest.raises(can.CanInitializationError, match="no hub"):
        HubBus(name)
    hub.wait()
    end.append(started(HUB, name))
    HubBus(name).shutdown()
