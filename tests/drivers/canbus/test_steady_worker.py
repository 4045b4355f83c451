"""A worker whose turns compiled code takes, on the test bus: it follows, rests, loses its link and comes back."""

import itertools
import os
import threading
import time
from pathlib import Path

import cantools
import numpy as np
import pytest
from micromanip_drivers.canbus.driver import CanBus, CanBusOptions

from micromanip.bus.image import ProcessImage
from micromanip.bus.last_given import LastGiven
from micromanip.bus.safe_state import SWITCH, VOLTAGE, SafeOutput
from micromanip.bus.worker import Rules, Worker
from micromanip.rt.bus_exchange import exchange_image
from micromanip.rt.bus_image import EPOCH, FOLLOWING, IMAGE, OUTPUT_STATE, RESTING
from micromanip.rt.records import MAX_OUTPUTS, MAX_SIGNALS, SIGNAL
from micromanip.testbus.faults import BusOff

from .hub_in_thread import BITRATE, DATA_BITRATE, bench

pytestmark = [pytest.mark.live, pytest.mark.compiled_only]

FOLDER = Path(__file__).parents[3] / "config"
DATABASE = cantools.database.load_file(FOLDER / "can/manipulator.dbc")
SENSORS, VOLTAGES = (DATABASE.get_message_by_name(name) for name in ("Sensors", "Voltages"))
REST = dict.fromkeys((signal.name for signal in SENSORS.signals), 0)
FD = {"fd": True, "bitrate_switch": True}
RATE_HZ, STEP_V = 200.0, 10.0
PATIENCE_S = 20.0
OUTPUTS = [SafeOutput(VOLTAGE, 0.0, -20.0, 150.0, STEP_V * RATE_HZ)] * 3 + [SafeOutput(SWITCH, 0.0, 0.0, 1.0)] * 3
NAMES = [f"Voltages.{signal.name}" for signal in VOLTAGES.signals if signal.name != "Count"]
RULES = Rules(OUTPUTS, 0.1, 300_000_000, 100_000_000)


class Running:
    """A worker in a thread, a device that answers each command with its voltage as strain, and the loop's side."""

    def __init__(self, at, memory):
        options = {
            "receive": {"Sensors": {"rate_hz": RATE_HZ, "counter": "Count"}},
            "send": {"Voltages": {"rate_hz": RATE_HZ, "counter": "Count"}},
        }
        link = {"interface": "micromanip", "bitrate": BITRATE, "data_bitrate": DATA_BITRATE, "silence_ms": None}
        self.driver = CanBus(
            CanBusOptions(channel=at.channel, database="can/manipulator.dbc", **link, **options), FOLDER
        )
        self.at, self.heard = at, []
        self.record = np.zeros(1, IMAGE)
        self.record["inputs"], self.record["outputs"] = len(self.driver.inputs), len(self.driver.outputs)
        self.record["silent_ns"] = 10**10
        self.image = ProcessImage(self.record)
        self.outputs, self.signals = np.zeros(MAX_OUTPUTS), np.zeros(MAX_SIGNALS, SIGNAL)
        self.worker = Worker(self.driver, self.image, RULES, memory)
        self.thread = threading.Thread(target=self.worker.run)

    def __enter__(self):
        self.thread.start()
        return self

    def __exit__(self, *raised):
        self.worker.end()
        self.thread.join(PATIENCE_S)
        assert not self.thread.is_alive()

    @property
    def state(self):
        return self.image.ask(OUTPUT_STATE)

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

    def until(self, condition, voltage=None):
        """Let device (and, with a voltage, loop) go on until `condition` holds."""
        end = time.monotonic() + PATIENCE_S
        while not condition():
            assert time.monotonic() < end, "it did not come to pass"
            if voltage is not None:
                self.outputs[0] = voltage
                exchange_image(self.record[0], self.outputs, self.signals, time.monotonic_ns())
            self.turn()
            time.sleep(0.001)

    def has(self, voltage):
        return bool(self.heard) and abs(self.heard[-1]["voltage_x"] - voltage) < 0.01

    def steps_V(self):
        return np.abs(np.diff([values["voltage_x"] for values in self.heard]))


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
