"""What is read: answers to fresh samples of the inputs."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from micromanip.driver import Channel, Inbox

from .client import Answer
from .exchange import Exchange
from .plan import COUNTER, STATUS, TaskPlan
from .timing import Timing

_BAD = -1
"""Status of samples whose device says 0, and 0 is not good."""


@dataclass
class _Reading:
    """What is in the answer to one transaction."""

    channels: tuple[tuple[int, int, int], ...]
    """Place among the values of the answer, index of the input, and its age in the device (ns)."""
    status: int | None
    counter: int | None
    good: tuple[int, ...]
    request_ns: int
    answer_ns: int
    last: float | None = None


class Answers:
    """The inputs of all tasks."""

    def __init__(self, plans: Sequence[TaskPlan], timing: Timing) -> None:
        self.channels = [channel for plan in plans for channel in _channels(plan, timing)]
        self.repeated = 0
        """Answers in which the device's counter had not moved: no fresh samples."""
        index = {channel.name: i for i, channel in enumerate(self.channels)}
        self._readings = {
            id(exchange): _reading(plan, exchange, index, timing) for plan in plans for exchange in plan.exchanges
        }

    def forget(self) -> None:
        """The line was opened anew: the next count of each device is fresh."""
        for reading in self._readings.values():
            reading.last = None

    def take(self, answer: Answer, inbox: Inbox) -> None:
        """Put the samples of an answer into `inbox`, dated between request and answer, if they are fresh."""
        reading = self._readings[id(answer.exchange)]
        if not reading.channels:
            return
        status = 0
        if reading.status is not None or reading.counter is not None:
            codes = answer.exchange.codes(answer.pdu)
            if reading.counter is not None:
                before, reading.last = reading.last, codes[reading.counter]
                if reading.last == before:
                    self.repeated += 1
                    return
            if reading.status is not None and codes[reading.status] not in reading.good:
                status = int(codes[reading.status]) or _BAD
        first_ns, last_ns = answer.sent_ns + reading.request_ns, answer.received_ns - reading.answer_ns
        taken_ns = min((first_ns + last_ns) // 2, answer.received_ns)
        values = answer.exchange.values(answer.pdu)
        for place, channel, age_ns in reading.channels:
            inbox.put(channel, values[place], taken_ns - age_ns, status)


def _channels(plan: TaskPlan, timing: Timing) -> Iterator[Channel]:
    latency_s = timing.input_latency_s(plan)
    for name, keys in zip(plan.inputs, plan.options.read.values(), strict=True):
        yield Channel(name, plan.options.rate_hz, latency_s + keys.latency_us * 1e-6)


def _reading(plan: TaskPlan, exchange: Exchange, index: dict[str, int], timing: Timing) -> _Reading:
    names = exchange.inputs
    return _Reading(
        channels=tuple(_placed(plan, names, index)),
        status=names.index(STATUS) if STATUS in names else None,
        counter=names.index(COUNTER) if COUNTER in names else None,
        good=plan.options.status.good if plan.options.status else (),
        request_ns=round(timing.request_s(exchange) * 1e9),
        answer_ns=round(timing.answer_s(exchange) * 1e9),
    )


def _placed(plan: TaskPlan, names: Sequence[str], index: dict[str, int]) -> Iterator[tuple[int, int, int]]:
    ages_us = {name: keys.latency_us for name, keys in zip(plan.inputs, plan.options.read.values(), strict=True)}
    for place, name in enumerate(names):
        if name in index:
            yield place, index[name], round(ages_us[name] * 1e3)
