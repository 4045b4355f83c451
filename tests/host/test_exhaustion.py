"""A host that runs out of something: it says so and ends, its outputs at rest; or it waits until there is more."""

import asyncio
import errno
import resource
import signal
import threading
from pathlib import Path

import pytest

from campaigns.running_controller import until
from micromanip.client import Client
from micromanip.errors import CheckFailed, MicromanipError
from micromanip.host import bus_worker
from micromanip.host.bus_worker import BusWorker
from micromanip.host.exhaustion import Exhaustion, begun_threads
from tests.cells import LEISURELY
from tests.further import further


@pytest.fixture(autouse=True)
def no_alarm():
    yield
    signal.alarm(0)


def heard(*problems):
    said, ends = [], []
    exhaustion = Exhaustion(said.append, lambda: ends.append(None))
    return exhaustion, [exhaustion.hear(problem, "status") for problem in problems], said, ends


def test_no_memory_or_no_thread_begins_the_end_once():
    exhaustion, kinds, said, ends = heard(ValueError("x"), MemoryError(), RuntimeError("can't start new thread"))
    assert kinds == [False, True, True]
    assert said == ["WARNING: the host is out of memory (status): it ends, the outputs go to park"]
    assert len(ends) == 1
    with pytest.raises(CheckFailed, match="out of memory"):
        exhaustion.judge()


def test_any_other_error_of_a_verb_ends_nothing():
    exhaustion, kinds, said, ends = heard(ValueError("x"), RuntimeError("another"))
    assert (kinds, said, ends) == ([False, False], [], [])
    exhaustion.judge()


def test_a_task_that_lasts_as_long_as_the_run_and_fails_ends_it():
    exhaustion, _, _, ends = heard()

    async def run():
        async def fails():
            raise ValueError("x")

        exhaustion.watch(task := asyncio.create_task(fails(), name="look"))
        await asyncio.wait({task})
        await asyncio.sleep(0)

    asyncio.run(run())
    assert len(ends) == 1
    with pytest.raises(CheckFailed, match="bug: look failed: ValueError: x"):
        exhaustion.judge()


def test_threads_that_will_be_needed_are_there_from_the_start():
    before = threading.active_count()
    with begun_threads(2, "verbs"):
        assert threading.active_count() == before + 2


@pytest.mark.live  # a running controller
@pytest.mark.parametrize("share", [1.0, *further(0.0)])
def test_a_controller_without_memory_ends_with_its_outputs_at_park(run, share):
    """Also where it has far more than it may have: what it lets go of would not be given again."""
    cell = run(LEISURELY).reach("TRACKING")
    pages = int(Path(f"/proc/{cell.process.pid}/statm").read_text().split()[0])
    resource.prlimit(cell.process.pid, resource.RLIMIT_AS, (int(share * pages) * resource.getpagesize(),) * 2)

    def asks():
        if cell.process.poll() is None:
            try:
                with Client(cell.socket) as client:
                    client.request("get")
            except (MicromanipError, OSError):
                pass
        return cell.process.poll() is not None

    until(asks, cell.last_words)
    assert cell.wait() == 1, cell.said
    assert "out of memory" in cell.said
    assert "Traceback" not in cell.report.get("error", "")
    cell.gone()


def test_a_worker_that_died_comes_back_once_there_are_descriptors_again(monkeypatch):
    worker, lacks, said = BusWorker.__new__(BusWorker), [OSError(errno.EMFILE, "Too many open files")] * 3, []
    worker.name, worker._ending = "board", False

    async def start(say):
        if lacks:
            raise lacks.pop()
        say("started")

    monkeypatch.setattr(worker, "start", start)
    monkeypatch.setattr(bus_worker, "_AGAIN_S", 0.0)
    asyncio.run(worker._start_again(said.append))
    assert said == [
        "WARNING: driver board: no new process: Too many open files; tried again each second",
        "started",
    ]
