"""The sensitivity through the gateway: asked in the token's name, judged from what the controller answers."""

import asyncio
import json
from dataclasses import asdict

import numpy as np
import pytest

from micromanip.control.injection import injection
from micromanip.control.pid import pid_system
from micromanip.errors import CheckFailed
from micromanip.gateway.app import Gateway
from micromanip.gateway.guard import Origins
from micromanip.gateway.tokens import Token, Tokens
from micromanip.settings.check import prepare
from micromanip.settings.wiring.timing import AT_ONCE
from tests.host.standin import SIMULATED

from .asgi import request
from .rings import Played

SEE, DO = "s" * 24, "d" * 24
PERIOD_S, GAIN, CORNER_HZ = 1e-4, 0.7, 900.0


def plant(hertz):
    """A lag and one cycle of delay."""
    return GAIN * np.exp(-2j * np.pi * hertz * PERIOD_S) / (1.0 + 1j * hertz / CORNER_HZ) ** 2


class Answering:
    """The controller, as the cell's `order` sees it: a plant that is linear, and a little noise."""

    def __init__(self, configuration):
        self.configuration, self.asked, self.number, self.looks = configuration, [], 0, 0

    async def __call__(self, verb, name, **fields):
        self.asked.append((verb, name, fields))
        if "axis" in fields:
            if fields["axis"] not in self.configuration.axes:
                raise CheckFailed("there is no such axis")
            self.number, self.looks = self.number + 1, 0
            told = self.configuration.model_dump(mode="json")
            return {"number": self.number, "seconds": 5.0, "configuration": told, "path": asdict(AT_ONCE)}
        self.looks += 1
        if self.looks < 2:
            return {"number": self.number, "done": False, "progress": 0.5}
        hertz = injection(0.3, 3000.0, 1e4, seed=1).frequency_Hz
        rng = np.random.default_rng(self.number)
        U = np.exp(2j * np.pi * rng.random((9, len(hertz))))
        noise = rng.normal(size=(2, *U.shape)) * 1e-3
        Y = plant(hertz) * U + noise[0] + 1j * noise[1]
        pairs = [np.stack([each.real, each.imag], axis=-1).tolist() for each in (U, Y)]
        answer = {"number": self.number, "done": True, "progress": 1.0, "frequency_Hz": hertz.tolist()}
        return answer | {"input": pairs[0], "output": pairs[1]}


@pytest.fixture
def cell(tmp_path):
    made = Played(tmp_path / "control.sock").cell
    made.order = Answering(prepare(SIMULATED).configuration)
    return made


@pytest.fixture
def ask(cell):
    tokens = Tokens([Token("screen", "observe", SEE), Token("ana", "operate", DO)])
    app = Gateway(cell, tokens, Origins(), lambda: None).guard

    def asked(body, token=DO):
        code, _, text = asyncio.run(request(app, "/api/sensitivity", method="POST", body=body, token=token))
        return code, json.loads(text)

    return asked


@pytest.mark.long
def test_the_margins_are_those_of_the_plant_that_answers(ask, cell):
    axis = cell.order.configuration.axes["x"]
    omega = 2 * np.pi * np.geomspace(20.0, 3000.0, 4000)
    L = pid_system(axis.inner, PERIOD_S).response(omega) * plant(omega / (2 * np.pi))
    Ms = float((1.0 / np.abs(1.0 + L)).max())
    code, begun = ask({"axis": "x", "loop": "strain", "amplitude_um": 0.3, "seed": 1})
    assert (code, begun["seconds"]) == (200, 5.0)
    look = {"number": begun["number"], "with": [7]}
    assert ask(look)[1] == {"number": begun["number"], "done": False, "progress": 0.5}
    answer = ask(look)[1]
    assert answer["problem"] is None
    found = answer["found"]
    assert found["measured"]["Ms"] == pytest.approx(Ms, rel=0.03)
    assert found["Ms_least"] <= 1.02 * Ms
    assert len(found["sensitivity"]) == len(found["frequency_Hz"])
    assert {name for _, name, _ in cell.order.asked} == {"ana"}


def test_only_who_operates_may_and_only_what_makes_sense(ask, cell):
    assert ask({"axis": "x"}, SEE)[0] == 403
    assert ask({"axis": "x", "gain": 3})[0] == 400
    assert ask({"number": 1, "axis": "x"})[0] == 400
    assert ask({"number": 1, "with": "x"})[0] == 400
    assert cell.order.asked == []
    assert ask({"axis": "w"}) == (409, {"error": "there is no such axis"})
