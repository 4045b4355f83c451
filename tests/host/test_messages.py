"""Nobody reads standard error any more, or reads it and stands still: a cell goes on tracking all the same."""

import os
import signal
import threading
import time

import pytest

from micromanip.cli.messages import Printer, _Descriptor
from tests.cells import LEISURELY

GONE_ON_CYCLES = 500
"""At 200 Hz 2.5 s: more than the loop lives without a sign of life of its host."""


@pytest.fixture
def pipe():
    """Both ends, the first for us."""
    ends = list(os.pipe())
    yield ends
    for end in ends:
        os.close(end)


def fill(writing):
    """Until nothing more goes in."""
    os.set_blocking(writing, False)
    try:
        while True:
            os.write(writing, b"\n" * 512)
    except BlockingIOError:
        os.set_blocking(writing, True)


def test_a_reader_that_stands_still(run, tmp_path):
    """A pager, Ctrl-S, a journal that hangs: before, the loop went to rest for want of the host's sign of life."""
    fifo = tmp_path / "fifo"
    os.mkfifo(fifo)
    held = os.open(fifo, os.O_RDWR)
    try:
        fill(held)
        cell = run(LEISURELY, prefix=("sh", "-c", f'exec "$@" 2>{fifo}', "sh"))
        cell.reach("TRACKING")
        cell.go_on(GONE_ON_CYCLES)
        assert cell.state == "TRACKING"
        cell.process.send_signal(signal.SIGINT)
        assert cell.wait() == 0
        assert cell.report["state"] == "OFF"
        assert cell.left == []
    finally:
        os.close(held)


def test_a_printer_whose_stream_stands_still(pipe):
    """Whoever has something to say goes on at once; so does the end, shortly."""
    reading, writing = pipe
    fill(writing)
    stream = _Descriptor(writing)
    with Printer() as printer:
        for k in range(5000):  # more than wait
            printer.do(lambda k=k: stream.write(f"{k}\n"))
        began = time.monotonic()
    assert time.monotonic() - began < 60.0
    assert os.read(reading, 10) == b"\n" * 10
    while not printer._waiting.empty():  # or its thread goes on with a number that another test opens
        os.read(reading, 1 << 16)
    done = threading.Event()
    printer.do(done.set)
    assert done.wait(60.0)


def test_a_printer_whose_stream_breaks_does_the_rest():
    """Rich ends the program where it meets a broken pipe."""

    def leave():
        raise SystemExit(1)

    closed, done = _Descriptor(-1), threading.Event()
    with Printer() as printer:
        printer.do(lambda: closed.write("lost"))
        printer.do(leave)
        printer.do(done.set)
    assert done.is_set()
