"""A worker in a thread of the test, with the loop's side of its image."""

import threading
import time

import numpy as np

from micromanip.bus.image import ProcessImage
from micromanip.bus.worker import Worker
from micromanip.rt.bus_exchange import exchange_image
from micromanip.rt.bus_image import IMAGE, OUTPUT_STATE
from micromanip.rt.records import MAX_OUTPUTS, MAX_SIGNALS, SIGNAL

PATIENCE_S = 60.0


class RunningWorker:
    """Serves `driver` by `rules`; what the device does meanwhile is for ``turn`` of a subclass."""

    def __init__(self, driver, rules, memory):
        self.driver = driver
        self.record = np.zeros(1, IMAGE)
        self.record["inputs"], self.record["outputs"] = len(driver.inputs), len(driver.outputs)
        self.record["silent_ns"] = self.record["patience_ns"] = 10**10
        self.image = ProcessImage(self.record)
        self.outputs, self.signals = np.zeros(MAX_OUTPUTS), np.zeros(MAX_SIGNALS, SIGNAL)
        self.worker = Worker(driver, self.image, rules, memory, simulated=True)
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

    def turn(self):
        """Let the device do something."""

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
