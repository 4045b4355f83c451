"""A real loop driven from Python, parameters swapped while it tracks: its recording has every cycle and every set."""

import asyncio
import contextlib
import os
from dataclasses import replace

import numpy as np
import pytest

from campaigns.running_controller import PATIENCE_S
from micromanip.host.controller import Controller
from micromanip.host.recording.recording import RecorderProcess
from micromanip.host.shared_memory import RingReader
from micromanip.recordings import open_telemetry
from micromanip.rt import mailbox as w
from micromanip.rt.states import ARM, STOP
from micromanip.rt.telemetry import ROW
from micromanip.settings.check import prepare
from tests.cells import QUICK, WAITING, simulated

pytestmark = pytest.mark.live  # a real loop


@pytest.fixture(scope="module")
def prepared(tmp_path_factory):
    file = tmp_path_factory.mktemp("prepared") / "cell.yaml"
    file.write_text(simulated(*QUICK, *WAITING))
    return prepare(file)


@contextlib.asynccontextmanager
async def tracking(prepared, folder):
    """The controller, TRACKING; afterwards its loop has ended by itself."""
    controller = Controller(prepared, folder / "none.sock")

    async def beat():
        while True:
            controller.beat()
            await asyncio.sleep(0.02)

    try:
        await controller.start()
        beating = asyncio.create_task(beat())
        ended = asyncio.create_task(controller.wait())
        try:
            await controller.command(ARM)
            await until(lambda: controller.state == "TRACKING", controller)
            yield controller
            await controller.command(STOP)
            await asyncio.wait_for(ended, PATIENCE_S)
            assert controller.process.code == 0
        finally:
            if not ended.done():
                controller.process.kill()
                await ended
            beating.cancel()
    finally:
        for descriptor in controller.segments.descriptors:
            os.close(descriptor)


async def until(condition, controller):
    async with asyncio.timeout(PATIENCE_S):
        while not condition():
            assert controller.process.runs, "the loop has ended"
            await asyncio.sleep(0.005)


async def pass_cycles(controller, count):
    goal = controller.words[w.CYCLES_RUN] + count
    await until(lambda: controller.words[w.CYCLES_RUN] >= goal, controller)


async def recorded(controller, file, during):
    """Record while `during(controller)` goes on: (what the recorder said, rows seen beside it, the file)."""
    recorder = RecorderProcess(controller, file, print)
    await recorder.start()
    beside, seen = RingReader(controller.ring), []

    async def follow():
        while True:
            seen.append(beside.read())
            await asyncio.sleep(0.02)

    following = asyncio.create_task(follow())
    try:
        await during(controller)
    finally:
        said = await recorder.stop()
        following.cancel()
    return said, np.concatenate(seen), file


@pytest.fixture(scope="module")
def one_run(prepared, tmp_path_factory):
    """Recordings without a swap and over many."""
    folder = tmp_path_factory.mktemp("one_run")
    new = prepared.parameters.copy()

    async def quick_swaps(controller):
        for k in range(20):
            new[0]["axis"]["pid"]["K_V_per_um"] = 0.4 + 0.01 * k
            await controller.apply(replace(prepared, parameters=new))
        await pass_cycles(controller, 2000)

    async def main():
        async with tracking(prepared, folder) as controller:
            calm = await recorded(controller, folder / "calm.mcap", lambda _: pass_cycles(controller, 8000))
            quick = await recorded(controller, folder / "quick.mcap", quick_swaps)
            return {"calm": calm, "quick": quick}

    return asyncio.run(main())


def test_recording_has_every_cycle(prepared, one_run):
    said, seen, file = one_run["calm"]
    telemetry = open_telemetry(file)
    rows, state = np.concatenate(list(telemetry.rows())), telemetry.state[0]
    assert (telemetry.configuration, telemetry.sha256) == (prepared.source.text, prepared.source.hash)
    assert (telemetry.axes, telemetry.period_ns) == (["x", "y", "z"], 100_000)
    lost, missing = telemetry.end["lost"], rows["cycle"][-1] - state["cycle"] - rows["periods"].sum()
    assert telemetry.end["rows"] == len(rows)
    assert missing >= 0
    assert (lost > 0) == (missing > 0), "each cycle once, overruns told, and what a starved recorder lost is counted"
    (parameters,) = telemetry.parameters
    assert parameters["version"] == [1]
    assert parameters.tobytes() == prepared.parameters.tobytes()
    assert said == f"recorded {len(rows)} cycles to {file}, {lost} lost"
    assert len(rows) >= 8000
    assert rows.dtype == ROW
    same = rows[np.isin(rows["cycle"], seen["cycle"])]
    assert same.tobytes() == seen[np.isin(seen["cycle"], rows["cycle"])].tobytes()
    assert len(same) >= 1000
    if not lost:  # it begins right after the snapshot
        assert np.abs(state["axis"]["voltage_V"] - rows["axis"]["voltage_V"][0]).max() < 4.0 * rows["periods"][0]


def test_recording_over_quick_swaps_has_every_set(one_run):
    """A row's version names a set in the file, however quickly they followed each other."""
    _, _, file = one_run["quick"]
    telemetry = open_telemetry(file)
    rows, sets = np.concatenate(list(telemetry.rows())), np.concatenate(telemetry.parameters)
    assert rows["version"][-1] == 21
    assert (np.diff(rows["version"]) >= 0).all(), "whole, at a cycle boundary"
    assert len(np.unique(rows["version"])) >= 20
    assert list(sets["version"]) == list(np.unique(rows["version"]))
    gains = dict(zip(sets["version"].tolist(), sets["axis"]["pid"]["K_V_per_um"][:, 0], strict=True))
    assert all(gains[version] == pytest.approx(0.4 + 0.01 * (version - 2)) for version in gains if version > 1)
