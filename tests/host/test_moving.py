"""A move from its beginning to its end on a stand-in for the loop, which plays the law itself."""

import asyncio

import numpy as np
import pytest

from micromanip.errors import CheckFailed
from micromanip.host.control import moving
from micromanip.host.control.request import Request
from micromanip.rt.laws.move import advance_move

from .standin import ALICE, Cell, jogging

SINE = {"axis": "x", "kind": "sine", "amplitude_um": 5.0, "frequency_Hz": 2.0, "seconds": 30.0}
TURN_CYCLES = 100


class Playing(Cell):
    """Cycles pass a hundred at a time; `place_um` is where axis x is held from where it began."""

    def __init__(self, folder):
        super().__init__(folder, jogging(), state="HOLDING")
        self.axis, self.place_um, self.fastest, self.held = (
            self.controller.status["state"][0]["axis"][0],
            0.0,
            0.0,
            True,
        )
        axes = self.controller.status["state"][0]["axis"]
        axes["setpoint_um"], axes["voltage_V"] = 60.0, 70.0

    async def turn(self):
        while True:
            await asyncio.sleep(0.001)
            p = (self.controller.injected or [self.controller.prepared.parameters])[-1][0]["axis"][0]["move"]
            held = self.held and self.controller.state == "HOLDING"
            for k in range(TURN_CYCLES):
                advance_move(p, self.axis["move"], k, held)
                self.place_um += float(self.axis["move"]["speed_um"])
                self.fastest = max(self.fastest, abs(float(self.axis["move"]["speed_um"])))

    async def ask(self, verb, **fields):
        return await self.table[verb].act(Request(verb, fields, ALICE))

    def play(self, scenario):
        async def whole():
            turning = asyncio.create_task(self.turn())
            try:
                return await asyncio.wait_for(scenario(), 150.0)
            finally:
                turning.cancel()

        return asyncio.run(whole())

    async def ended(self, number):
        while not (found := await self.ask("move", number=number))["done"]:
            await asyncio.sleep(0.01)
        return found

    @property
    def rests(self):
        return not self.controller.injected[-1][0]["axis"]["move"]["kind"].any()


@pytest.fixture
def cell(tmp_path):
    return Playing(tmp_path)


def test_a_step_goes_there_and_stays_where_that_was_asked_for(cell):
    async def scenario():
        begun = await cell.ask("move", axis="x", kind="step", by_um=8.0, returns=False)
        assert (begun["number"], begun["done"], begun["seconds"]) == (1, False, pytest.approx(0.7))
        return await cell.ended(1)

    found = cell.play(scenario)
    assert (found["progress"], found["offset_um"]) == (1.0, 8.0)
    assert cell.place_um == pytest.approx(8.0)
    assert cell.rests
    assert cell.entries[-1][:2] == ("move", True)
    assert "by_um 8.0" in cell.entries[-1][2]["axes.x"][1]


def test_nothing_is_changed_or_armed_meanwhile_and_hold_lets_it_rest(cell):
    async def scenario():
        await cell.ask("move", **SINE)
        await asyncio.sleep(0.1)
        for verb, fields in (("arm", {}), ("set", {"changes": {"axes.x.inner.K_V_per_um": 0.5}}), ("move", SINE)):
            with pytest.raises(CheckFailed, match="a sine of axis x is under way"):
                await cell.ask(verb, **fields)
        assert cell.controller.commands == []
        await cell.ask("hold")
        with pytest.raises(CheckFailed, match="the move was stopped: hold was asked for; the axis is held"):
            await cell.ended(1)

    cell.play(scenario)
    assert cell.rests
    assert cell.fastest <= 5.0 * 2 * np.pi * 2.0 * 1e-4 * 1.3
    assert cell.controller.state == "HOLDING"


def test_it_comes_to_rest_where_nobody_asks_any_more(cell, monkeypatch):
    monkeypatch.setattr(moving, "_LEASE_S", 0.1)

    async def scenario():
        await cell.ask("move", **SINE)
        while not cell.verbs._tuning.moving._task.done():
            await asyncio.sleep(0.02)
        place = cell.place_um
        await asyncio.sleep(0.05)
        assert cell.place_um == place
        with pytest.raises(CheckFailed, match=r"nobody has asked for it for 0.1 s; the axis is held"):
            await cell.ask("move", number=1)

    cell.play(scenario)
    assert cell.rests
    assert cell.axis["move"]["passed"] < 300_000


def test_a_stop_that_is_asked_for_and_the_end_of_the_hold_end_it(cell):
    async def scenario():
        await cell.ask("move", **SINE)
        await asyncio.sleep(0.05)
        await cell.ask("move", number=1, stop=True)
        with pytest.raises(CheckFailed, match="the move was stopped: as was asked for"):
            await cell.ended(1)
        await cell.ask("move", **SINE)
        await asyncio.sleep(0.05)
        await cell.ask("disarm")
        with pytest.raises(CheckFailed, match="the move was ended by the loop: the state is RAMPING"):
            await cell.ended(2)

    cell.play(scenario)
    assert cell.rests


def test_a_sensor_that_is_lost_ends_it(cell):
    async def scenario():
        await cell.ask("move", **SINE)
        await asyncio.sleep(0.05)
        cell.held = False
        with pytest.raises(CheckFailed, match="a sensor of the axis is not usable"):
            await cell.ended(1)

    cell.play(scenario)
    assert cell.rests
