"""A worker whose turns compiled code takes, on the test bus: it follows, rests, loses its link and comes back."""

import itertools
import math
import os
import time
from pathlib import Path

import cantools
import numpy as np
import pytest
from micromanip_drivers.canbus.driver import CanBus, CanBusOptions

from micromanip.bus.bridge import BusBridge
from micromanip.bus.driver import BusOptions
from micromanip.bus.last_given import LastGiven
from micromanip.bus.safe_state import SWITCH, VOLTAGE, SafeOutput
from micromanip.bus.worker import Rules
from micromanip.rt.bus_image import EPOCH, FOLLOWING, RESTING
from micromanip.rt.laws.sensor import SENSOR_STATE, read_signal
from micromanip.testbus.faults import BusOff

from ..running_worker import RunningWorker
from .hub_in_thread import BITRATE, DATA_BITRATE, bench

pytestmark = [pytest.mark.live, pytest.mark.compiled_only]

FOLDER = Path(__file__).parents[3] / "config"
DATABASE = cantools.database.load_file(FOLDER / "can/manipulator.dbc")
SENSORS, VOLTAGES = (DATABASE.get_message_by_name(name) for name in ("Sensors", "Voltages"))
REST = dict.fromkeys((signal.name for signal in SENSORS.signals), 0)
FD = {"fd": True, "bitrate_switch": True}
RATE_HZ, STEP_V = 200.0, 10.0
OUTPUTS = [SafeOutput(VOLTAGE, 0.0, -20.0, 150.0, STEP_V * RATE_HZ)] * 3 + [SafeOutput(SWITCH, 0.0, 0.0, 1.0)] * 3
NAMES = [f"Voltages.{signal.name}" for signal in VOLTAGES.signals if signal.name != "Count"]
RULES = Rules(OUTPUTS, 0.1, 300_000_000, 100_000_000)


class Running(RunningWorker):
    """With a device that answers each command with its voltage as strain."""

    def __init__(self, at, memory):
        options = {
            "receive": {"Sensors": {"rate_hz": RATE_HZ, "counter": "Count"}},
            "send": {"Voltages": {"rate_hz": RATE_HZ, "counter": "Count"}},
        }
        link = {"interface": "micromanip", "bitrate": BITRATE, "data_bitrate": DATA_BITRATE, "silence_ms": None}
        driver = CanBus(CanBusOptions(channel=at.channel, database="can/manipulator.dbc", **link, **options), FOLDER)
        super().__init__(driver, RULES, memory)
        self.at, self.heard = at, []

    @property
    def compiled_frames(self):
        return self.driver._tables.counted("frames_out")

    def turn(self):
        """Take what the device heard, and have it answer."""
        while not self.at.device.heard.empty():
            frame, _ = self.at.device.heard.get()
            values = DATABASE.decode_message("Voltages", frame.data)
            self.heard.append(values)
            strain = SENSORS.encode(REST | {"strain_x": values["voltage_x"], "Count": len(self.heard) % 65536})
            self.at.send(0x101, strain, **FD)

    def has(self, voltage):
        return bool(self.heard) and abs(self.heard[-1]["voltage_x"] - voltage) < 0.01

    def steps_V(self):
        return np.abs(np.diff([values["voltage_x"] for values in self.heard]))


class Losing(Running):
    """Each fifth sample of its device never comes; what becomes of the others is counted as the loop counts."""

    def __init__(self, at):
        super().__init__(at, None)
        self.place = [channel.name for channel in self.driver.inputs].index("Sensors.strain_x")
        self.bridge = BusBridge(self.driver, BusOptions(), 10**10)
        self.sensor = np.zeros(1, SENSOR_STATE)[0]
        self.taken, self.lost, self.is_quiet = 0, 0, False

    def turn(self):
        while not self.is_quiet and not self.at.device.heard.empty():
            self.at.device.heard.get()
            for _ in range(3):  # at once: the loop sees the newest
                self.taken += 1
                if self.taken % 5 == 0:
                    self.lost += 1
                else:
                    sample = SENSORS.encode(REST | {"strain_x": float(self.taken), "Count": self.taken % 65536})
                    self.at.send(0x101, sample, **FD)
        read_signal(self.signals[self.place], self.sensor, time.monotonic_ns(), 10**12, (-1e9, 1e9), math.inf)

    def account(self):
        """Once all has come: taken and lost by the device, told of and lost by the loop; and superseded.

        A sample that is lost last of all is not known to be before the next one.
        """
        self.is_quiet = True
        taken, lost = self.taken - (self.taken % 5 == 0), self.lost - (self.taken % 5 == 0)
        newest, seen = self.record[0]["input"][self.place], self.signals[self.place : self.place + 1]
        self.until(lambda: max(abs(newest["value"] - taken), abs(seen[0]["value"] - taken)) < 0.01, 0.0)
        s, missing = self.sensor, int(self.bridge.missing(self.record.view(np.uint8))[self.place])
        self.is_quiet = False
        told = int(s["samples"] + s["refused"] + s["unseen"])
        return np.array([taken - told, lost - missing, s["unseen"] - missing])


def test_what_the_device_took_is_used_superseded_or_lost():
    with bench(f"account-{os.getpid()}") as at, Losing(at) as run:
        run.until(lambda: run.state == FOLLOWING, 0.0)
        run.until(lambda: run.taken > 10 and run.sensor["sequence"] > 0, 0.0)
        before = run.account()  # what came before the first look is told nowhere
        run.until(lambda: run.lost > 40, 0.0)
        untold, lost_untold, superseded = run.account() - before
        assert (untold, lost_untold) == (0, 0)
        assert superseded > 20, "several came at once"


def test_it_follows_rests_and_comes_back(tmp_path):
    with bench(f"steady-{os.getpid()}") as at:
        memory = LastGiven.open(f"micromanip-{at.channel}", NAMES, tmp_path)
        with Running(at, memory) as run:
            run.until(lambda: run.state == FOLLOWING, 0.0)
            run.until(lambda: run.has(80.0) and abs(run.signals[0]["value"] - 80.0) < 0.01, 80.0)
            assert run.compiled_frames > 0
            before = run.compiled_frames
            run.until(lambda: run.compiled_frames > before + 5, 80.0)
            assert LastGiven.open(run.driver.device, NAMES, tmp_path).read()[0] == 80.0
            assert run.image.known(1) == [80.0]

            run.until(lambda: run.state == RESTING and run.has(0.0))  # the loop is silent
            before = run.compiled_frames
            run.until(lambda: run.compiled_frames > before + 5)

            run.until(lambda: run.state == FOLLOWING, 0.0)
            run.until(lambda: run.has(60.0), 60.0)
            epoch = run.image.ask(EPOCH)
            at.inject(BusOff())
            run.until(lambda: run.image.ask(EPOCH) > epoch and run.state == RESTING and run.has(0.0), 60.0)
            assert run.driver.statistics()["bus_off"] == 1
            assert run.steps_V().max() < STEP_V + 0.01, "no break lets anything jump"
            counts = [int(values["Count"]) for values in run.heard]
            assert all((after - value) % 256 == 1 for value, after in itertools.pairwise(counts))
        memory.close()
