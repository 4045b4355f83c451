"""When a controller is ready: one declaration for `status` and commands. The test answers in the place of its loop."""

import asyncio
from pathlib import Path

import pytest

from micromanip.errors import CheckFailed
from micromanip.host import controller as module
from micromanip.host.controller import Controller
from micromanip.rt import mailbox as w
from micromanip.rt.states import ARM, READY, STOP
from micromanip.settings.check import prepare

SIMULATED = Path(__file__).parents[2] / "config" / "simulated.yaml"


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


def test_before_its_loop_turns_nothing_waits(controller):
    controller.words[w.CYCLES_RUN] = 0
    for command in (ARM, STOP):
        with pytest.raises(CheckFailed, match="still starting"):
            asyncio.run(controller.command(command))
