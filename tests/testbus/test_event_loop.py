"""The event loop of simulated devices: order, descriptors, stopping."""

import os
import time

import pytest

from micromanip.testbus.event_loop import EventLoop


@pytest.fixture
def loop():
    loop = EventLoop()
    yield loop
    loop.close()


def test_calls_come_in_order_of_time_and_not_early(loop):
    called = []
    now_ns = loop.now_ns()
    for name, after_us in (("c", 900), ("a", 300), ("b", 600), ("b2", 600)):
        loop.call_at(now_ns + after_us * 1000, lambda name=name: called.append((name, loop.now_ns() - now_ns)))
    loop.run(now_ns + 1_000_000)
    assert [name for name, _ in called] == ["a", "b", "b2", "c"]
    assert all(late_ns >= after for (_, late_ns), after in zip(called, (300e3, 600e3, 600e3, 900e3), strict=True))


def test_a_signal_that_comes_when_all_is_closed_does_no_harm():
    loop = EventLoop()
    loop.close()
    loop.stop()  # before: Bad file descriptor, or an event at whatever has this descriptor by then


def test_who_comes_late_and_asks_for_the_past_sees_all_in_its_order(loop):
    """A timer of 3 ns period, that has 10 periods to make up for, beside others."""
    called = []
    begin_ns = loop.now_ns() - 1000

    def tick():
        called.append(3 * len([name for name in called if name != "other"]))
        if called[-1] < 30:
            loop.call_at(begin_ns + called[-1] + 3, tick)

    loop.call_at(begin_ns, tick)
    for after_ns in (10, 20):
        loop.call_at(begin_ns + after_ns, lambda: called.append("other"))
    loop.run(loop.now_ns())
    assert called == [0, 3, 6, 9, "other", 12, 15, 18, "other", 21, 24, 27, 30]


def test_one_reader_may_remove_another_that_is_readable_too(loop):
    pipes = [os.pipe() for _ in range(2)]
    called = []

    def on_readable(read):
        called.append(read)
        for other, _ in pipes:
            loop.remove_reader(other)

    for read, write in pipes:
        os.write(write, b"x")
        loop.add_reader(read, lambda read=read: on_readable(read))
    loop.run(loop.now_ns() + 1_000_000)
    assert len(called) == 1
    for end in sum(pipes, ()):
        os.close(end)


def test_who_has_more_to_do_than_it_can_leaves_the_others_some_time(loop):
    """Each call brings the next one, at once: 2 ms of every 22 are the others', or more on a busy machine."""
    end_ns = time.monotonic_ns() + 400_000_000

    def again():
        if time.monotonic_ns() < end_ns:
            loop.call_at(time.monotonic_ns(), again)
        else:
            loop.stop()

    loop.call_at(0, again)
    began, began_cpu = time.monotonic(), time.thread_time()
    loop.run()
    paused_s = time.monotonic() - began - (time.thread_time() - began_cpu)
    assert paused_s > 0.02
