"""A child of the host: orders in, answers out by line, its end noticed however it comes."""

import asyncio
import os
import signal
import socket
import subprocess
import sys

import pytest

from micromanip.host.child import Child

TALKATIVE = """
import json, os, signal, sys
for line in sys.stdin:
    order = json.loads(line)
    if order == "pid":
        print(json.dumps({"pid": os.getpid(), "session": os.getsid(0)}), flush=True)
    elif order == "fail":
        print("it can't be done", file=sys.stderr, flush=True)
        sys.exit(7)
    elif order == "complain":
        print("a cable is cut\\nit is whole again", file=sys.stderr, flush=True)
    elif order == "end":
        sys.exit("it goes")
    elif order == "die":
        print('{"cut": ', end="", flush=True)
        os.kill(os.getpid(), signal.SIGKILL)
    elif order == "deaf":
        print("{}", flush=True)
        signal.pause()
    else:
        print(json.dumps(order), flush=True)
"""


@pytest.fixture
def module(tmp_path, monkeypatch):
    (tmp_path / "talkative.py").write_text(TALKATIVE)
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    return "talkative"


def test_orders_and_answers_until_it_is_to_end(module):
    async def main():
        child = Child(module, ())
        assert not child.runs
        assert child.code is None
        await child.start({"first": 1})
        child.send("pid")
        answers = child.answers()
        assert await anext(answers) == {"first": 1}
        assert child.runs
        about = await anext(answers)
        assert about["pid"] == about["session"]  # Ctrl-C in the terminal does not reach it
        assert about["session"] != os.getsid(0)
        child.end_orders()
        assert [answer async for answer in answers] == []
        assert await child.wait(10.0)
        assert (child.runs, child.code, child.end, child.was_killed) == (False, 0, "ended with 0", False)
        child.send("too late")
        child.kill()

    asyncio.run(main())


def test_a_death_is_noticed_and_what_it_cut_off_is_left_out(module):
    async def main():
        child = Child(module, ())
        for starts in (1, 2):
            await child.start({"whole": starts})
            child.send("die")
            assert [answer async for answer in child.answers()] == [{"whole": starts}]
            assert await child.wait(10.0)
            assert (child.code, child.end, child.starts) == (-signal.SIGKILL, "was killed by signal 9", starts)
            assert child.was_killed

    asyncio.run(main())


@pytest.mark.parametrize("over", [False, True])
def test_one_that_dies_is_started_again_and_one_that_always_dies_is_given_up(module, monkeypatch, over):
    monkeypatch.setattr("micromanip.host.child._RESTART_S", 0.0)
    monkeypatch.setattr("micromanip.host.child._RESTARTS", 2)
    child, said = Child(module, ()), []

    async def follow():
        await child.start("die")
        child.send("die")
        async for _ in child.answers():
            pass
        await child.wait(10.0)

    assert asyncio.run(child.keep_alive(follow, lambda: over, said.append, "learning")) == over
    assert child.starts == (1 if over else 3)
    assert said == ["WARNING: the learning process died; it is started again"] * (child.starts - 1)


def test_one_that_does_not_obey_is_killed(module):
    async def main():
        child = Child(module, ())
        await child.start("deaf")
        await anext(child.answers())
        child.end_orders()
        assert not await child.wait(0.2)
        child.kill()
        assert await child.wait(10.0)
        assert child.was_killed

    asyncio.run(main())


@pytest.mark.parametrize("module", ["host.trips.process", "host.recording.recorder"])
def test_a_child_begins_wherever_its_host_did(tmp_path, module):
    """A folder of the name of the package, a state directory, say, stands in its way no more."""
    (tmp_path / "micromanip" / "recordings").mkdir(parents=True)
    command = [sys.executable, "-P", "-m", f"micromanip.{module}"]
    ended = subprocess.run(command, cwd=tmp_path, input="", capture_output=True, text=True, check=False, timeout=150)
    assert (ended.returncode, ended.stderr) == (0, "")


HANDED = """
import json, os
from micromanip.host.shared_memory import receive_orders

print(json.dumps("begun"), flush=True)
orders, descriptors = receive_orders()
print(json.dumps([len(orders["options"]), [os.pread(each, 100, 0).decode() for each in descriptors]]), flush=True)
"""


@pytest.fixture
def handed(module, tmp_path):
    (tmp_path / "handed.py").write_text(HANDED)
    return "handed"


def test_one_that_was_begun_gets_orders_of_any_size_and_open_files(handed, tmp_path):
    def opened(name):
        (tmp_path / name).write_text(f"what {name} holds")
        return os.open(tmp_path / name, os.O_RDONLY)

    async def main():
        child = Child(handed)
        await child.begin()
        answers = child.answers()
        assert await anext(answers) == "begun"  # without orders
        descriptors = [opened("first"), opened("second")]
        child.send_orders({"options": "x" * 500_000}, descriptors)
        for each in descriptors:
            os.close(each)
        assert await anext(answers) == [500_000, ["what first holds", "what second holds"]]
        assert [answer async for answer in answers] == []
        assert await child.wait(10.0)
        await child.let_go()
        assert (child.code, child.starts) == (0, 1)

    asyncio.run(main())


def test_a_loop_whose_host_ended_before_it_gave_orders_ends_too():
    ours, theirs = socket.socketpair()
    command = [sys.executable, "-P", "-m", "micromanip.host.loop_process"]
    with theirs, subprocess.Popen(command, stdin=theirs, stdout=subprocess.PIPE, stderr=subprocess.STDOUT) as loop:
        ours.close()
        assert loop.communicate(timeout=150) == (b"", None)
    assert loop.returncode == 0
