"""What is saved from the scope: every byte of the ring, in a file that the readers of recordings take."""

import asyncio
import json

import numpy as np
import pytest

from micromanip.gateway.app import Gateway
from micromanip.gateway.guard import Origins
from micromanip.gateway.tokens import Token, Tokens
from micromanip.recordings import open_telemetry

from .answering import HASH, TEXT, Answering
from .asgi import request
from .rings import AXES, Played, rows, status

SEE = "s" * 24


@pytest.fixture
def played(tmp_path):
    made = Played(tmp_path / "control.sock")
    made.cell.status, made.cell.problem = status(), None
    controller = Answering(made.cell.socket)
    yield made
    controller.close()


def saved(played, **window):
    app = Gateway(played.cell, Tokens([Token("screen", "observe", SEE)]), Origins(), lambda: None).guard
    return asyncio.run(request(app, "/api/recording", method="POST", body=window, token=SEE))


async def several(played, count):
    """Status of so many that are asked for at once, and of one after them."""
    guard = Gateway(played.cell, Tokens([Token("screen", "observe", SEE)]), Origins(), lambda: None).guard

    def ask():
        return request(guard, "/api/recording", method="POST", body={"first": 0, "last": 90}, token=SEE)

    return sorted(answer[0] for answer in await asyncio.gather(*(ask() for _ in range(count)))), (await ask())[0]


def test_only_a_few_are_saved_at_a_time(played):
    played.play(noise(np.arange(100)))
    played.read()
    assert asyncio.run(several(played, 6)) == ([200, 200, 503, 503, 503, 503], 200)


def noise(cycles):
    rng = np.random.default_rng(len(cycles))
    made = rows(cycles, x_strain_um=rng.normal(size=len(cycles)), x_voltage_V=rng.normal(size=len(cycles)) * 1e-9)
    made["version"] = 3
    return made


def test_a_saved_window_is_the_rings_bytes(played, tmp_path):
    made = noise(np.r_[np.arange(20_000), np.arange(20_007, 40_000)])
    played.control["parameters"]["version"][5] = 3
    for part in np.array_split(made, 7):
        played.play(part)
        played.read()
    code, headers, content = saved(played, first=15_000, last=30_000)
    assert (code, headers["content-disposition"]) == (200, 'attachment; filename="scope-30000.mcap"')
    file = tmp_path / "saved.mcap"
    file.write_bytes(content)
    telemetry = open_telemetry(file)
    found = np.concatenate(list(telemetry.rows()))
    wanted = made[(made["cycle"] >= 15_000) & (made["cycle"] <= 30_000)]
    assert found.tobytes() == wanted.tobytes()
    assert (telemetry.axes, telemetry.period_ns) == (AXES, 100_000)
    assert (telemetry.configuration, telemetry.sha256) == (TEXT, HASH)
    assert telemetry.end
    assert [each["version"].tolist() for each in telemetry.parameters] == [[3]]
    assert telemetry.marks[0]["cycle"] == 15_000


@pytest.mark.parametrize("window", [{"first": 5, "last": 3}, {"first": 7, "last": 9}, {"first": "a", "last": 3}, {}])
def test_a_window_that_holds_nothing_is_refused(played, window):
    played.play(noise(np.arange(5)))
    played.read()
    code, _, text = saved(played, **window)
    assert code == 400
    assert json.loads(text)["error"]
