"""Word to the service manager, read from a real datagram socket in its place."""

import asyncio
import os
import time

import pytest

from micromanip.host.notify import ServiceManager


def test_each_message_is_one_datagram(manager):
    service = ServiceManager({"NOTIFY_SOCKET": manager.path})
    before = time.monotonic_ns() // 1000
    service.ready()
    with service.reload():
        assert len(manager()) == 2
    service.stopping()
    ready, reloading, ready_again, stopping = manager()
    assert (ready, ready_again, stopping) == ("READY=1", "READY=1", "STOPPING=1")
    first, second = reloading.split("\n")
    assert first == "RELOADING=1"
    name, _, value = second.partition("=")
    assert name == "MONOTONIC_USEC"
    assert before <= int(value) <= time.monotonic_ns() // 1000


def test_a_reload_that_fails_ends_too_and_one_while_starting_is_not_told(manager):
    service = ServiceManager({"NOTIFY_SOCKET": manager.path})
    with service.reload():
        pass
    assert manager() == []
    service.ready()
    with pytest.raises(ValueError, match="wrong"), service.reload():
        raise ValueError("wrong")
    assert [message.partition("\n")[0] for message in manager()] == ["READY=1", "RELOADING=1", "READY=1"]


def test_status_is_one_line_and_sent_on_change_only(manager):
    service = ServiceManager({"NOTIFY_SOCKET": manager.path})
    for text in ("READY", "READY", "FAULT: X-101\nREADY=1"):
        service.status(text)
    assert manager() == ["STATUS=READY", "STATUS=FAULT: X-101 READY=1"]


@pytest.mark.parametrize("path", ["", "/nowhere/at/all", "/" + "x" * 200])
def test_nobody_listens(path):
    service = ServiceManager({"NOTIFY_SOCKET": path})
    service.ready()
    service.status("READY")


def test_a_manager_that_does_not_read_holds_up_nothing(manager):
    service = ServiceManager({"NOTIFY_SOCKET": manager.path})
    for number in range(5000):  # far more than the socket's queue takes
        service.status(str(number))
    assert 0 < len(manager()) < 5000


@pytest.mark.parametrize(
    ("environment", "watchdog_s"),
    [
        ({"WATCHDOG_USEC": "5000000"}, 5.0),
        ({"WATCHDOG_USEC": "5000000", "WATCHDOG_PID": str(os.getpid())}, 5.0),
        ({"WATCHDOG_USEC": "5000000", "WATCHDOG_PID": "1"}, None),
        ({"WATCHDOG_USEC": "0"}, None),
        ({"WATCHDOG_USEC": "soon"}, None),
        ({}, None),
    ],
)
def test_watchdog_that_is_meant_for_us(environment, watchdog_s):
    assert ServiceManager({"NOTIFY_SOCKET": "@x"} | environment).watchdog_s == watchdog_s


def test_watchdog_is_fed_only_while_everything_moves(manager):
    """Three counters; from a certain look on, one of them stands still."""
    service = ServiceManager({"NOTIFY_SOCKET": manager.path, "WATCHDOG_USEC": "20000"})
    looks = 0

    def progress():
        nonlocal looks
        looks += 1
        return looks, min(looks, 4), looks

    async def feed():
        task = asyncio.create_task(service.feed_while(progress))
        while looks < 10:
            await asyncio.sleep(0.001)
        task.cancel()

    asyncio.run(feed())
    assert manager() == ["WATCHDOG=1"] * 4
