"""What a driver puts in is what the worker hands over, one by one or a frame at once."""

import numpy as np

from micromanip.bus.image import ProcessImage
from micromanip.bus.inbox import Inbox, Sample
from micromanip.rt.bus_image import IMAGE


def published(fill):
    """The image's inputs after an inbox that `fill` has filled; the inbox is empty then."""
    record = np.zeros(1, IMAGE)
    record["inputs"] = 4
    inbox = Inbox()
    fill(inbox)
    ProcessImage(record).publish(inbox)
    assert not len(inbox)
    assert not list(inbox)
    return record[0]["input"][:4]


def one_by_one(inbox):
    for channel, value in enumerate((1.5, -2.5, 0.0), 1):
        inbox.put(channel, value, 77, 3, 2)


def at_once(inbox):
    inbox.put_all(1, [1.5, -2.5, 0.0], 77, 3, 2)


def test_a_frame_is_what_its_values_are_one_by_one():
    first, second = Inbox(), Inbox()
    one_by_one(first)
    at_once(second)
    assert (
        list(first) == list(second) == [Sample(1, 1.5, 77, 3, 2), Sample(2, -2.5, 77, 3, 2), Sample(3, 0.0, 77, 3, 2)]
    )
    assert len(first) == len(second) == 3
    assert first.lost == second.lost == 6
    assert (published(one_by_one) == published(at_once)).all()
    assert published(at_once)["value"].tolist() == [0.0, 1.5, -2.5, 0.0]
    assert published(at_once)["sequence"].tolist() == [0, 3, 3, 3]


def test_the_newest_wins_and_the_older_one_is_not_lost():
    def fill(inbox):
        inbox.put_all(0, [1.0, 2.0], 10)
        inbox.put(1, 3.0, 20)

    inputs = published(fill)
    assert inputs["value"][:2].tolist() == [1.0, 3.0]
    assert inputs["time_ns"][:2].tolist() == [10, 20]
    assert inputs["sequence"][:2].tolist() == [1, 2]
