"""How urgently a worker process runs, and when it does not."""

import os
import signal
import subprocess
import sys
import threading
from pathlib import Path

import pytest

from campaigns.running_controller import until
from micromanip.bus.worker_process import take_rights

PRIORITY = 10


@pytest.fixture
def thread():
    """Runs a function in a thread of its own, whose rights end with it."""

    def run(function):
        problems = []

        def caught():
            try:
                function()
            except BaseException as problem:
                problems.append(problem)

        one = threading.Thread(target=caught)
        one.start()
        one.join()
        if problems:
            raise problems[0]

    return run


def may_be_urgent():
    before = os.sched_getscheduler(0)
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(PRIORITY))
    except PermissionError:
        return False
    os.sched_setscheduler(0, before, os.sched_param(0))
    return True


def test_to_open_a_driver_holds_nobody_up_and_what_it_begins_is_urgent(thread, monkeypatch):
    began, ends = [], threading.Event()
    waiting = threading.Thread(target=lambda: (began.append(threading.get_native_id()), ends.wait()))

    def worker():
        if not may_be_urgent():
            pytest.skip("no right to SCHED_FIFO here")
        monkeypatch.setattr("os.listdir", lambda _: [str(threading.get_native_id()), *map(str, began), "4194303"])
        at_ease = take_rights(None, None, PRIORITY)
        assert os.sched_getscheduler(0) == os.SCHED_FIFO
        with at_ease():
            assert os.sched_getscheduler(0) == os.SCHED_OTHER
            waiting.start()
            while not began:
                pass
        assert os.sched_getparam(0).sched_priority == PRIORITY
        assert os.sched_getscheduler(began[0]) == os.SCHED_FIFO

    try:
        thread(worker)
    finally:
        ends.set()


def test_without_the_right_it_works_all_the_same_and_says_so(thread, monkeypatch, capfd):
    def refused(*_):
        raise PermissionError

    monkeypatch.setattr("os.sched_setscheduler", refused)
    with take_rights(None, None, PRIORITY)():
        pass
    assert "no real-time priority" in capfd.readouterr().out


def test_it_keeps_off_the_cpu_of_the_loop(thread):
    cpus = os.sched_getaffinity(0)
    if len(cpus) < 2:
        pytest.skip("one CPU only")

    def worker():
        take_rights(None, min(cpus), PRIORITY)
        assert os.sched_getaffinity(0) == cpus - {min(cpus)}

    thread(worker)


def test_it_goes_to_its_own_cpu_where_one_is_given(thread):
    own = max(os.sched_getaffinity(0))

    def worker():
        take_rights(own, own, PRIORITY)
        assert os.sched_getaffinity(0) == {own}

    thread(worker)


def test_a_cpu_that_is_not_there_is_told(thread, capfd):
    def worker():
        before = os.sched_getaffinity(0)
        take_rights(1023, None, PRIORITY)
        assert os.sched_getaffinity(0) == before

    thread(worker)
    assert "not pinned to CPU 1023" in capfd.readouterr().out


@pytest.mark.live
def test_a_signal_that_all_of_a_service_get_ends_the_host_only():
    """One that ended by it at rest was started anew while the host stopped, and had forgotten what it had given."""
    worker = subprocess.Popen([sys.executable, "-m", "micromanip.bus.worker_process"], stdin=subprocess.PIPE)

    def ignored(number):
        found = Path(f"/proc/{worker.pid}/status").read_text().split("SigIgn:\t")[1].split("\n")[0]
        return int(found, 16) >> (number - 1) & 1

    try:
        until(lambda: ignored(signal.SIGTERM), lambda: "it does not begin")  # the last; nohup has the first ignored
        for number in (signal.SIGHUP, signal.SIGINT, signal.SIGTERM):
            worker.send_signal(number)
        worker.stdin.close()  # the host is gone
        assert worker.wait(60) == 0
    finally:
        worker.kill()
        worker.wait()
