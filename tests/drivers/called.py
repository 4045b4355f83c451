"""A cyclic driver without a loop: called as the loop does, by the addresses of its four functions."""

import numpy as np

from micromanip.bus.cyclic import EXCHANGE_C, call_context
from micromanip.rt.records import SIGNAL


class Called:
    """`driver` with its context, which knows its safe values where `safe` gives them; ``with`` opens and closes it."""

    def __init__(self, driver, safe=None):
        self.driver, self.context = driver, driver.context()
        if safe is not None:
            driver.adopt(self.context, safe)
        self.signals, self.outputs = np.zeros(len(driver.inputs), SIGNAL), np.zeros(len(driver.outputs))
        self.functions = driver.functions()
        self._exchange = EXCHANGE_C(self.functions.exchange)

    def open(self):
        self.driver.begin(self.context)
        assert self.call("open") == 0
        return self

    def close(self):
        self.call("close")

    def __enter__(self):
        return self.open()

    def __exit__(self, *_):
        self.close()

    def call(self, name):
        """`open`, `safe` or `close`: its return code."""
        return call_context(getattr(self.functions, name), self.context.ctypes.data)

    def exchange_at(self, now_ns, periods=1):
        """One exchange of the loop, with `outputs` as they are; its return code."""
        at = self.context.ctypes.data, self.outputs.ctypes.data, self.signals.ctypes.data
        return self._exchange(*at, now_ns, periods)

    @property
    def statistics(self):
        return self.driver.statistics(self.context)

    def sample(self, name):
        return self.signals[self.driver.inputs.index(name)]
