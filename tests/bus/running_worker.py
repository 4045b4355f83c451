"""A worker in a thread of the test, with the loop's side of its image."""

import threading
import time

import numpy as np

from micromanip.bus.image import ProcessImage
from micromanip.bus.worker import Worker
from micromanip.rt.bus_exchange import exchange_image
from micromanip.rt.bus_image import FOLLOWING, IMAGE, OUTPUT_STATE
from micromanip.rt.records import MAX_OUTPUTS, MAX_SIGNALS, SIGNAL

PATIENCE_S = 60.0


class RunningWorker:
    """Serves `driver` by `rules`; what the device does meanwhile is for ``turn`` of a subclass."""

    def __init__(self, driver, rules, memory=None, record=None, **known):
        self.driver = driver
        self.record = np.zeros(1, IMAGE) if record is None else record
        self.record["inputs"], self.record["outputs"] = len(driver.inputs), len(driver.outputs)
        self.record["silent_ns"] = self.record["patience_ns"] = 10**12
        self.image = ProcessImage(self.record)
        self.outputs, self.signals = np.zeros(MAX_OUTPUTS), np.zeros(MAX_SIGNALS, SIGNAL)
        self.worker = Worker(driver, self.image, rules, memory, **known)
        self.safe, self.bug = self.worker.safe, None
        self.thread = threading.Thread(target=self._run, daemon=True)

    def _run(self):
        try:
            self.worker.run()
        except Exception as problem:
            self.bug = problem

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

    def cycle(self, voltage=0.0):
        """One of the loop; what it is told."""
        self.outputs[0] = voltage
        return exchange_image(self.record[0], self.outputs, self.signals, time.monotonic_ns())

    def until(self, condition, voltage=None):
        """Let device (and, with a voltage, loop) go on until `condition` holds."""
        end = time.monotonic() + PATIENCE_S
        while not condition():
            assert time.monotonic() < end, "it did not come to pass"
            if voltage is not None:
                self.cycle(voltage)
            self.turn()
            time.sleep(0.0005)

    def follow(self, voltage, has_it):
        """Until the device has what the loop wants."""
        self.until(lambda: self.safe.state == FOLLOWING, 0.0)
        self.until(has_it, voltage)
