"""What more bandwidth costs: only what holds a loop back buys some, and a design that there is not costs nothing."""

from dataclasses import dataclass
from functools import partial
from types import SimpleNamespace

import pytest

from micromanip.control.system import delay
from micromanip.design.commission.prices import Price, outer_prices, section, strain_prices
from micromanip.design.synthesise import tune_pid
from micromanip.design.synthesise.search import UNKNOWN
from micromanip.errors import CheckFailed
from micromanip.settings.wiring.timing import AT_ONCE

from ..synthesise.test_synthesis import ANCHOR_PID, T, lag


@dataclass
class Known:
    dynamics: object
    delay: int
    path: object = AT_ONCE

    @property
    def system(self):
        return delay(self.delay, T).then(self.dynamics)


def test_less_delay_and_less_hysteresis_buy_bandwidth_where_they_hold_it_back():
    actuator = Known(lag(0.65, 2500.0, 0), 8)
    given = {"actuator": actuator.system, "slopes": (0.75, 1.0, 1.35, 1.8, 2.4), "radius": None, "residual": 0.1}
    now, *better = strain_prices(partial(tune_pid, ANCHOR_PID), given, actuator, tune_pid(ANCHOR_PID, **given))
    bought = {price.what: price.left / now.left for price in better}
    assert bought["with half the delay"] < 0.8
    assert bought["without more hysteresis than slopes of .75 to 1.3 times"] < 0.9
    assert bought["with a response that is known exactly"] == pytest.approx(1.0), "it was"


def test_the_outer_loop_is_designed_again_without_what_holds_it_back():
    def tune(**given):
        if given["unsure"](1.0) > 0.0:
            raise CheckFailed("no")
        return SimpleNamespace(bandwidth_Hz=120.0)

    design = SimpleNamespace(bandwidth_Hz=80.0, obstacle=UNKNOWN)
    given = {"noise_um": 0.01, "unsure": lambda omega: 0.3 * omega}
    assert [price.bandwidth_Hz for price in outer_prices(tune, given, design)] == [80.0, 120.0]
    design.obstacle = ""
    assert outer_prices(tune, given, design) == (Price("as it is", 80.0),), "no design, no price"
    table = section({"outer": ("nothing limits it", outer_prices(tune, given, design))}).tables[0]
    assert table.rows == [("outer", "as it is", "80 Hz", "")]
