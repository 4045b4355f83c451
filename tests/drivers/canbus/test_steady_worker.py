"""A worker whose turns compiled code takes, on the test bus: no sample is lost untold."""

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
from micromanip.bus.safe_state import SWITCH, VOLTAGE, SafeOutput
from micromanip.bus.worker import Rules
from micromanip.rt.bus_image import FOLLOWING
from micromanip.rt.laws.sensor import SENSOR_STATE, read_signal

from ..running_worker import RunningWorker
from .hub_in_thread import BITRATE, DATA_BITRATE, bench

pytestmark = [pytest.mark.live, pytest.mark.compiled_only]

FOLDER = Path(__file__).parents[3] / "config"
SENSORS = cantools.database.load_file(FOLDER / "can/manipulator.dbc").get_message_by_name("Sensors")
REST = dict.fromkeys((signal.name for signal in SENSORS.signals), 0)
FD = {"fd": True, "bitrate_switch": True}
RATE_HZ, STEP_V = 200.0, 10.0
OUTPUTS = [SafeOutput(VOLTAGE, 0.0, -20.0, 150.0, STEP_V * RATE_HZ)] * 3 + [SafeOutput(SWITCH, 0.0, 0.0, 1.0)] * 3
RULES = Rules(OUTPUTS, 0.1, 300_000_000, 100_000_000)


class Losing(RunningWorker):
    """Each fifth sample of its device never comes; what becomes of the others is counted as the loop counts."""

    def __init__(self, at):
        options = {
            "receive": {"Sensors": {"rate_hz": RATE_HZ, "counter": "Count"}},
            "send": {"Voltages": {"rate_hz": RATE_HZ, "counter": "Count"}},
        }
        link = {"interface": "micromanip", "bitrate": BITRATE, "data_bitrate": DATA_BITRATE, "silence_ms": None}
        driver = CanBus(CanBusOptions(channel=at.channel, database="can/manipulator.dbc", **link, **options), FOLDER)
        super().__init__(driver, RULES, None)
        self.at = at
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
        assert run.driver._tables.counted("frames_out") > 40, "compiled code had its part"
