"""Clients of a running controller may do what they like: the loop does not notice."""

import resource
from contextlib import ExitStack

import pytest

from campaigns.running_controller import reset, until
from micromanip.client import Client
from micromanip.errors import CheckFailed, UsageError
from micromanip.rt import mailbox as w
from micromanip.rt.states import ARM
from tests.cells import LEISURELY, Talk, changed

from .whole_module import tracking_until_the_end

pytestmark = pytest.mark.live  # a running controller

STATUS = b'{"version": 1, "verb": "status"}'


@pytest.fixture(scope="module")
def tracking(tmp_path_factory):
    """One controller for all who abuse it; it ends cleanly in the end."""
    with tracking_until_the_end(tmp_path_factory.mktemp("abuse"), LEISURELY) as cell:
        yield cell
    assert "exception" not in cell.said
    assert not cell.socket.exists()


@pytest.fixture
def cell(tracking):
    """A controller that tracks; after each test it still does."""
    assert tracking.state == "TRACKING"
    tracking.go_on(10)
    yield tracking
    tracking.go_on(10)
    assert tracking.state == "TRACKING"
    assert tracking.control["words"][w.COMMAND] == ARM
    assert tracking.control["words"][w.VERSION] == 1
    with Talk(tracking.socket) as talk:
        assert talk.ask(STATUS)["result"]["state"] == "TRACKING"


def test_wrong_commands_for_the_state(cell):
    with Client(cell.socket) as client:
        with pytest.raises(CheckFailed, match=r"^reset refused: the state is TRACKING$"):
            client.reset()
        with pytest.raises(CheckFailed, match=r"^arm refused: the state is TRACKING: arming begins in READY"):
            client.arm()
        with pytest.raises(UsageError, match="unknown verb 'stop'; known are analyse_live, arm, "):
            client.request("stop")
        assert client.status()["state"] == "TRACKING"


def test_two_hundred_connections(cell):
    """Some of them silent, some in the middle of a line; each is answered, and none leaves a descriptor behind."""
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    assert soft > 500 or hard > 500, "too few descriptors for this test"
    before = cell.descriptors
    with ExitStack() as stack:
        talks = [stack.enter_context(Talk(cell.socket)) for _ in range(200)]
        for talk in talks[::2]:
            talk.send(STATUS[:10])
        assert all(talk.ask(STATUS)["ok"] for talk in talks[1::2])
        for talk in talks[::2]:
            talk.send(STATUS[10:] + b"\n")
        assert all(talk.hear()["ok"] for talk in talks[::2])
    until(lambda: cell.descriptors <= before, lambda: f"{cell.descriptors} descriptors are open, before {before}")


def test_fault_is_latched_until_reset(run):
    """A fault shows in the status, refuses to arm, and is cleared by reset only; then nothing moves by itself."""
    patient = ("share_percent: null", "share_percent: null, in_a_row: 100")  # half a second: no stall of this machine
    cell = run(changed(LEISURELY, patient)).reach("TRACKING")
    cell.stall(1.0)
    cell.reach("FAULT")
    with Client(cell.socket) as client:
        until(lambda: "X-102" in cell.said, cell.last_words)
        (fault,) = client.status()["faults"]
        assert fault.startswith("X-102")
        with pytest.raises(CheckFailed, match=r"^arm refused: the state is FAULT: .*; a fault is latched .*; X-102 "):
            client.arm()
        reset(client)
        assert client.status()["faults"] == []
        cell.go_on(20)
        assert cell.state == "READY"
        client.arm()
        cell.reach("TRACKING")
    assert cell.end() == 0
    assert cell.report["faults"] == []
    assert sum(line.startswith("X-102 ") for line in cell.said.splitlines()) == 1  # told once
