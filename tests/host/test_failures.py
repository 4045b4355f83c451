"""A host in which something fails, or that runs out of something: it ends, its outputs at rest, or waits for more."""

import asyncio
import errno
import resource
from pathlib import Path

import pytest

from campaigns.running_controller import until
from micromanip.client import Client
from micromanip.errors import CheckFailed, MicromanipError
from micromanip.host import bus_worker
from micromanip.host.bus_worker import BusWorker
from micromanip.host.failures import Failures
from tests.cells import LEISURELY
from tests.further import further


def test_a_task_that_lasts_as_long_as_the_run_and_fails_ends_it():
    ends = []
    failures = Failures(lambda: ends.append(None))

    async def run():
        async def fails():
            raise ValueError("x")

        failures.watch(task := asyncio.create_task(fails(), name="look"))
        await asyncio.wait({task})
        await asyncio.sleep(0)

    asyncio.run(run())
    assert len(ends) == 1
    with pytest.raises(CheckFailed, match="bug: look failed: ValueError: x"):
        failures.judge()


def test_an_error_of_a_verb_ends_nothing():
    failures = Failures(pytest.fail)
    failures.hear(RuntimeError("another"))
    failures.judge()


@pytest.mark.live  # a running controller
@pytest.mark.parametrize("share", [1.0, *further(0.0)])
def test_a_controller_without_memory_ends_with_its_outputs_at_park(run, share):
    """Also where it has far more than it may have."""
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
    cell.gone()
    assert cell.state == "OFF"


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
