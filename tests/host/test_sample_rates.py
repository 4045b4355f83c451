"""A sensor that comes less often than its driver states is told for what it is; what is lost now and then is not."""

from types import SimpleNamespace

import numpy as np
import pytest

from campaigns.report import CONFIG
from micromanip.host.shared_memory import STATUS
from micromanip.host.signal_statistics import SignalStatistics
from micromanip.rt.telemetry import ROW
from micromanip.settings.check import prepare

SIMULATED = CONFIG / "simulated.yaml"
STRAIN, STAGE, DEVIATION = 1, 2, 4
RATE_HZ = 10_000


@pytest.fixture(scope="module")
def prepared():
    return prepare(SIMULATED)


class Sensors:
    """Rows as a loop would write them; `came` says in which of the rows a sensor of axis x had a sample."""

    def __init__(self, prepared):
        self.status = np.zeros(1, STATUS)[0]
        self.rates = SignalStatistics(SimpleNamespace(prepared=prepared, status=self.status))

    def play(self, came, at_a_time=2000, bit=STRAIN):
        rows = np.zeros(len(came), ROW)
        tracked = np.arange(len(came)) % 10 == 0
        rows["axis"]["fresh"] = np.where(tracked, STRAIN | STAGE | DEVIATION, STRAIN | STAGE)[:, None]
        fresh = rows["axis"]["fresh"][:, 0]
        rows["axis"]["fresh"][:, 0] = np.where(came, fresh | bit, fresh & ~bit)
        for at in range(0, len(rows), at_a_time):
            self.rates.add(rows[at : at + at_a_time])
        return self.rates.slow()


@pytest.fixture
def sensors(prepared):
    return Sensors(prepared)


def every(n, rows=2 * RATE_HZ):
    return np.arange(rows) % n == 0


def test_a_gauge_at_a_third_of_its_rate_is_told_with_figures_and_the_next_step(sensors):
    (told,) = sensors.play(every(3), at_a_time=1999)
    assert told.startswith("strain_x comes 3333 times a second, its driver cell states 10000: ")
    assert "acts by its calm gains as long as that lasts (W-217)" in told
    assert told.endswith("or state the rate that comes in drivers.cell and commission again")
    assert list(sensors.rates.news()) == [told]
    assert list(sensors.rates.news()) == []
    assert sensors.play(every(1)) == [], "it is no more"


@pytest.mark.parametrize(
    "came",
    [
        every(1),
        ~every(4),
        every(1) & (np.arange(2 * RATE_HZ) % 2000 > 900),  # an interrupted cable, again and again
        np.random.default_rng(1).random(2 * RATE_HZ) > 0.4,
        np.zeros(2 * RATE_HZ, bool),  # silent: a fault of its own
        every(3, RATE_HZ // 2),  # not for long
    ],
)
def test_losses_and_silence_are_not_told_as_a_rate(came, sensors):
    assert sensors.play(came) == []
