"""Each sample that a device took is told as one of four: used, refused, superseded by a newer one, or lost."""

import math

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from micromanip.bus import report
from micromanip.bus.bridge import BusBridge
from micromanip.bus.driver import BusOptions, Channel
from micromanip.bus.frame_plan import DeviceCounter
from micromanip.bus.image import ProcessImage
from micromanip.bus.inbox import Inbox
from micromanip.rt.bus_exchange import exchange_image
from micromanip.rt.bus_image import IMAGE
from micromanip.rt.laws.sensor import SENSOR_STATE, read_signal
from micromanip.rt.records import MAX_OUTPUTS, MAX_SIGNALS, SIGNAL


def test_lost_is_told_in_samples_as_received_is(monkeypatch):
    """Whatever the driver counts by that name: frames, as a rule."""
    told = []
    monkeypatch.setattr(report, "send_message", lambda **document: told.append(document))
    one = report.Report()
    one.counts["received"], one.counts["lost"] = 300, 45
    one.tell_counts(0, {"lost": 3, "overflows": 1})
    counts = told[0]["counts"]
    assert (counts["received"], counts["lost"], counts["overflows"]) == (300, 45, 1)


class OneInput:
    """As much of a bus driver as its bridge asks for."""

    inputs, outputs = (Channel("strain", 1000.0),), ()


TAKEN, BAD, LOST, TWICE, OVERTAKEN = range(5)
SAMPLE = st.sampled_from([TAKEN, TAKEN, TAKEN, BAD, LOST, TWICE, OVERTAKEN])
CYCLE = st.lists(SAMPLE, max_size=4)
"""What becomes of the samples between two cycles of the loop; those of a missed cycle come with the next one's."""


@given(st.lists(CYCLE, max_size=60), st.integers(0, 5))
def test_each_sample_is_counted_once(cycles, before):
    bridge = BusBridge(OneInput(), BusOptions(), 10**12)
    context = bridge.context()
    image = ProcessImage(context.view(IMAGE))
    counter, inbox, signals = DeviceCounter(256), Inbox(), np.zeros(MAX_SIGNALS, SIGNAL)
    sensor, count, taken, lost = np.zeros(1, SENSOR_STATE)[0], 0, 0, 0

    def comes(number, value):
        missing = counter.lost_before(number)
        if missing is not None:
            inbox.put(0, value, 0, lost=missing)

    for _ in range(before):  # while the loop does not look yet
        comes(count, 1.0)
        count += 2
    comes(count, 1.0)
    count += 1
    image.publish(inbox)
    for now, fates in enumerate([[], *cycles, [TAKEN]], 1):
        for fate in fates:
            if fate in (TAKEN, BAD, TWICE):
                comes(count, math.nan if fate == BAD else 1.0)
            if fate == TWICE:
                comes(count, 1.0)
            if fate == OVERTAKEN:
                comes(count + 1, 1.0)
                comes(count, 1.0)
            count += 1 + (fate == OVERTAKEN)
            taken += 1 + (fate == OVERTAKEN)
            lost += fate in (LOST, OVERTAKEN)
        image.publish(inbox)
        exchange_image(image.record[0], np.zeros(MAX_OUTPUTS), signals, now)
        read_signal(signals[0], sensor, now, 10**12, (-1e9, 1e9), math.inf)
    assert sensor["samples"] + sensor["refused"] + sensor["unseen"] == taken + 1
    assert bridge.missing(context).tolist() == [lost]
    assert 0 <= lost <= sensor["unseen"]
