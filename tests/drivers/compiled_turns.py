"""A bus driver whose compiled functions do all that they can, and Python what these leave, as in a worker."""

import ctypes
import math
import select
import struct
import time

import numpy as np

from micromanip.bus.driver import Outcome
from micromanip.bus.errors import OutputRefused
from micromanip.rt.io.worker_records import INBOX, NOTHING_SENT, UNCONFIRMED

_FUNCTION = ctypes.CFUNCTYPE(
    ctypes.c_int32, ctypes.c_void_p, ctypes.c_void_p, ctypes.c_void_p, ctypes.c_int64, ctypes.c_int64
)


def call_receive(functions, inbox, began_ns=0):
    """Take what is there into `inbox`, an array (1,) of INBOX, as the worker's loop does; what the function says."""
    return _FUNCTION(functions.receive)(functions.context.ctypes.data, 0, inbox.ctypes.data, began_ns, 0)


def call_send(functions, values, task=0):
    """Send `values` by one task; what the function says."""
    values = np.array(values, float)
    return _FUNCTION(functions.send)(functions.context.ctypes.data, values.ctypes.data, 0, time.monotonic_ns(), task)


def bits(values):
    """IEEE 754 patterns; a number that is none is one pattern, whatever the processor makes of its payload."""
    return [b"nan" if math.isnan(value) else struct.pack("<d", value) for value in values]


def drawn_value(draw, field, codes):
    """A value of `field`: a code or beside one, at the ends of `codes`, or what is not to be sent; None: a float."""
    if draw.random() < 0.1:
        return draw.choice([math.nan, math.inf, -math.inf, 1e300, -1e300])
    if codes is None:
        return draw.choice([0.0, -0.0, draw.gauss(0, 1), draw.gauss(0, 1e-6), draw.uniform(-6e4, 6e4)])
    low, high = map(int, codes)
    code = draw.choice([low, high, low - 1, high + 1, draw.randint(low, high)])
    return (code + draw.choice([0.0, 0.5, -0.5, 0.25])) * field.scale + field.offset


def assert_sent_alike(draw, fields, python, send, heard, taken=0):
    """Values drawn for `fields`, each (field, codes): `python` gives the bytes, or refuses; compiled code as well."""
    for _ in range(6):
        values = [drawn_value(draw, field, codes) for field, codes in fields]
        try:
            expected = python(values)
        except OutputRefused:
            assert send(values) == NOTHING_SENT
            assert not heard()
            continue
        assert send(values) == taken
        assert heard() == expected


class CompiledTurns:
    """Goes before the driver among the bases of a class."""

    def __init__(self, options, folder):
        super().__init__(options, folder)
        self.functions, self.samples = self.steady(), np.zeros(1, INBOX)
        assert self.functions is not None

    def perform(self, task, values, inbox):
        if self.functions.fileno() < 0:
            return super().perform(task, values, inbox)
        code = call_send(self.functions, values, task)
        if code == 0:
            return None
        return Outcome.SENT if code == UNCONFIRMED else super().perform(task, [float(v) for v in values], inbox)

    def receive(self, inbox, until_ns):
        if self.functions.fileno() < 0:
            super().receive(inbox, until_ns)
            return
        began_ns = time.monotonic_ns()
        select.select([self.functions.fileno()], [], [], max(0, until_ns - began_ns) * 1e-9)
        samples = self.samples[0]
        before, received = samples["signal"]["sequence"].copy(), int(samples["received"])
        samples["confirmed"] = 0
        code = call_receive(self.functions, self.samples, began_ns)
        ahead = samples["signal"]["sequence"] - before
        missing = np.maximum(ahead - 1, 0)
        overtaken = int(samples["received"]) - received - np.count_nonzero(ahead)
        while overtaken > 0:  # came, and a newer one with the same call: where it grew most, since all miss as many
            most = missing == missing.max()
            missing[most] -= 1
            overtaken -= np.count_nonzero(most)
        for i in np.flatnonzero(ahead):
            signal = samples["signal"][i]
            inbox.put(int(i), float(signal["value"]), int(signal["time_ns"]), int(signal["status"]), int(missing[i]))
        for task in np.flatnonzero(samples["confirmed"]):
            inbox.confirm(int(task))
        if code != 0:
            super().receive(inbox, time.monotonic_ns())
