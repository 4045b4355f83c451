"""When a controller is ready: one declaration for `status` and commands. The test answers in the place of its loop."""

import asyncio
from types import SimpleNamespace

import pytest

from campaigns.report import CONFIG
from micromanip.errors import CheckFailed, DeviceUnavailable
from micromanip.host import controller as module
from micromanip.host import workers
from micromanip.host.controller import Controller
from micromanip.host.workers import Workers
from micromanip.rt import mailbox as w
from micromanip.rt.states import ARM, READY, RESET, STOP
from micromanip.settings.check import prepare

SIMULATED = CONFIG / "simulated.yaml"


@pytest.fixture
def controller(tmp_path):
    """Its loop turns, in READY, and accepts what it is told."""
    controller = Controller(prepare(SIMULATED), tmp_path / "none.sock")
    controller.words[w.STATE], controller.words[w.CYCLES_RUN] = READY, 3
    return controller


async def obey(controller):
    """The loop's side of the commands."""
    while True:
        number = controller.control["words"][w.COMMAND_NUMBER]
        if number != controller.words[w.COMMAND_DONE]:
            controller.words[w.COMMAND_ACCEPTED] = 1
            controller.words[w.COMMAND_DONE] = number
        await asyncio.sleep(0)


def test_a_command_before_ready_waits_and_status_says_starting(controller):
    async def life():
        loop = asyncio.create_task(obey(controller))
        arming = asyncio.create_task(controller.command(ARM))
        await asyncio.sleep(0.05)
        assert controller.state == "STARTING"
        assert not arming.done()
        assert controller.control["words"][w.COMMAND_NUMBER] == 0
        controller.declare_ready()
        assert controller.state == "READY"
        await arming
        assert controller.control["words"][w.COMMAND] == ARM
        loop.cancel()

    asyncio.run(life())


def test_what_never_becomes_ready_refuses_but_can_be_stopped(controller, monkeypatch):
    monkeypatch.setattr(module, "_READY_S", 0.05)

    async def life():
        loop = asyncio.create_task(obey(controller))
        with pytest.raises(CheckFailed, match="arm refused: the controller is still starting"):
            await controller.command(ARM)
        await controller.command(STOP)
        assert controller.control["words"][w.COMMAND] == STOP
        loop.cancel()

    asyncio.run(life())


def test_a_loop_that_has_died_is_a_fault_whatever_it_said_last(controller):
    """The outputs may be anywhere until `make_safe` has done its work, which takes seconds."""
    controller.declare_ready()
    controller.process._process = SimpleNamespace(returncode=None)
    assert (controller.state, controller.faults()) == ("READY", [])
    controller.process._process.returncode = -9
    assert controller.state == "FAULT"
    (said,) = controller.faults()
    assert str(said).startswith("X-104")
    assert "signal 9" in str(said)
    for asked in (controller.command(RESET), controller.commanding().__aenter__()):
        with pytest.raises(CheckFailed, match=r"(reset refused|nothing was changed): X-104"):
            asyncio.run(asked)


class Hand:
    """A worker whose device is at rest and follows after so many looks."""

    name, said, way_to_rest_s, outputs_text = "piezo", "it hangs", 0.05, "voltage_x unknown, last 68 V"

    def __init__(self, looks):
        self.looks = looks

    @property
    def is_in_hand(self):
        self.looks -= self.looks > 0
        return self.looks == 0


@pytest.fixture
def hands(monkeypatch):
    monkeypatch.setattr(workers, "_IN_HAND_S", 0.05)
    all_of_them = Workers.__new__(Workers)
    all_of_them._workers = [Hand(1), Hand(3)]
    return all_of_them


def test_ready_is_told_when_every_device_rests(hands):
    assert asyncio.run(hands.in_hand(lambda: False))


def test_a_device_that_is_not_brought_to_rest_is_never_ready(hands):
    hands._workers[1] = Hand(1_000_000)
    with pytest.raises(DeviceUnavailable, match=r"driver piezo: .* voltage_x unknown, last 68 V; it hangs"):
        asyncio.run(hands.in_hand(lambda: False))
    assert not asyncio.run(hands.in_hand(lambda: True)), "a loop that died, or a stop, comes first"
