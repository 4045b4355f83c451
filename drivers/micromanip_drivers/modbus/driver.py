"""The driver `modbus`: registers of Modbus TCP and RTU devices, read and written at fixed rates.

A task sends its request and returns; the answer is taken by ``receive``, or by the next request, which waits for it. Of
each value it is known that it was taken between the end of the request and the beginning of the answer: it is dated in
the middle of the two.

When the line is opened, the registers that are written are read back: they say where the outputs stand.
"""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

from micromanip.driver import Answer as Found
from micromanip.driver import (
    BusDriver,
    BusError,
    Channel,
    DeviceFault,
    Inbox,
    LinkError,
    Load,
    Outcome,
    PartMissing,
    StillOpening,
    Task,
    TransientError,
    Watchdog,
)

from ..line.frame_options import BAD
from .client import OPEN_NS, Answer, Client
from .exchange import Exchange
from .hello import discover, greet, probe
from .options import READ_BACK, WRITES, ModbusOptions
from .plan import COUNTER, STATUS, TaskPlan, Timing, plan_tasks


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
                status = int(codes[reading.status]) or BAD
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


_READ_BACK_NS = 400_000_000


class Modbus(BusDriver):
    """Devices on one line; channels are called unit.register."""

    Options: ClassVar[type[ModbusOptions]] = ModbusOptions

    def __init__(self, options: ModbusOptions, folder: Path) -> None:  # noqa: ARG002 (it reads no files)
        self._options = options
        self._plans = plan_tasks(options)
        self._timing = Timing(options)
        self._timing.refuse_short_timeout(self._plans)
        self._answers = Answers(self._plans, self._timing)
        self._outputs = [channel for plan in self._plans for channel in self._outputs_of(plan)]
        self._names = [channel.name for channel in self._outputs]
        self._client = Client(options, self._timing)
        self._unanswered: dict[int, set[int]] = {}
        """Transactions of the newest turn of each task that the device has not answered yet."""
        self._asked = 0
        """The task whose request went out last."""
        self._missing: frozenset[int] = frozenset()
        self._told: set[int] = set()
        """Transactions that were taken otherwise than wished, which people know."""

    @property
    def device(self) -> str:
        return self._options.device

    @property
    def silence(self) -> Watchdog | None:
        return self._options.watchdog

    @property
    def inputs(self) -> Sequence[Channel]:
        return self._answers.channels

    @property
    def outputs(self) -> Sequence[Channel]:
        return self._outputs

    @property
    def tasks(self) -> Sequence[Task]:
        return [
            Task(plan.name, plan.options.rate_hz, tuple(map(self._names.index, plan.outputs))) for plan in self._plans
        ]

    def loads(self) -> Sequence[Load]:
        return [self._timing.load(self._plans)]

    def open(self) -> None:
        deadline_ns = time.monotonic_ns() + OPEN_NS
        self._answers.forget()
        self._unanswered.clear()
        self._missing = frozenset()
        try:
            self._client.open(deadline_ns)
            greet(self._client, self._options, self._plans, deadline_ns)
        except PartMissing as problem:
            self._missing = problem.tasks
            raise
        except BusError as problem:
            if isinstance(problem, LinkError) and self._client.may_be_starting:
                raise StillOpening(str(problem)) from problem
            self._client.close()
            raise

    def read_outputs(self) -> Sequence[float | None]:
        plans = [plan for number, plan in enumerate(self._plans) if number not in self._missing]
        found = read_back(self._client, plans, time.monotonic_ns() + _READ_BACK_NS)
        return [found.get(name) for name in self._names]

    def perform(self, task: int, values: Sequence[float], inbox: Inbox) -> Outcome | None:
        """Send the requests of a task; it waits for the answer of the one before, until that is late.

        All values are looked at before the first request goes. A time-out of the one before is raised, and the newest
        values are on their way all the same where the line allows it.
        """
        plan = self._plans[task]
        named = dict(zip(self._names, values, strict=True))
        requests = [exchange.request(named) for exchange in plan.exchanges]
        failure: TransientError | None = None
        try:
            self._finish(inbox)
        except TransientError as problem:
            failure = problem
        if failure is None and self._client.is_silent():
            return Outcome.HELD
        self._unanswered[task] = {id(exchange) for exchange in plan.exchanges}
        for exchange, request in zip(plan.exchanges, requests, strict=True):
            try:
                self._finish(inbox)
            except TransientError as problem:
                failure = failure or problem
            try:
                self._client.ask(exchange, request)
                self._asked = task
            except TransientError as problem:
                raise failure or problem from problem
        if failure is not None:
            raise failure
        return Outcome.SENT

    def receive(self, inbox: Inbox, until_ns: int) -> None:
        try:
            answer = self._client.answer(until_ns)
        except BusError as problem:
            problem.task = self._asked
            raise
        if answer is not None:
            self._take(answer, inbox)

    def _take(self, answer: Answer, inbox: Inbox) -> None:
        """Samples, and the word that a task's outputs have arrived: when all its requests are answered.

        A value that the device took otherwise has not arrived; that is said once.
        """
        self._answers.take(answer, inbox)
        if refusal := answer.exchange.refusal(answer.asked, answer.pdu):
            if id(answer.exchange) not in self._told:
                self._told.add(id(answer.exchange))
                inbox.remark(refusal)
            return
        for task, unanswered in self._unanswered.items():
            if id(answer.exchange) in unanswered:
                unanswered.remove(id(answer.exchange))
                if not unanswered:
                    inbox.confirm(task)

    def close(self) -> None:
        self._client.close()

    def statistics(self) -> Mapping[str, int]:
        return {**self._client.statistics(), "repeated": self._answers.repeated}

    def probe(self, seconds: float) -> Iterator[Found]:
        return probe(self._options, self._client, seconds)

    @classmethod
    def discover(cls, section: Mapping[str, Any], seconds: float) -> tuple[str, Iterator[Found]]:
        driver = cls(ModbusOptions.model_validate(section), Path())
        return driver.device, discover(driver._options, driver._client, seconds)

    def _finish(self, inbox: Inbox) -> None:
        """Take the answer to the request that is out. Raises what that brings."""
        while self._client.waits:
            self.receive(inbox, time.monotonic_ns() + 1_000_000_000)  # its own time-out comes first

    def _outputs_of(self, plan: TaskPlan) -> Iterator[Channel]:
        latency_s = self._timing.output_latency_s(plan)
        for name, keys in zip(plan.outputs, plan.options.write.values(), strict=True):
            yield Channel(name, plan.options.rate_hz, latency_s + keys.latency_us * 1e-6, keys.safe)


def read_back(client: Client, plans: Sequence[TaskPlan], until_ns: int) -> dict[str, float]:
    """Values by the outputs' names, without those that a unit does not tell: it may let them be written only.

    Each transaction is tried once: nothing says that a unit which refuses in silence is worth waiting for. Raises
    LinkError.
    """
    found: dict[str, float] = {}
    for exchange in (exchange for plan in plans for exchange in plan.exchanges):
        if exchange.written is None:
            continue
        function = READ_BACK[WRITES[exchange.function]]
        asking = Exchange(exchange.unit_id, f"{exchange.title}, read back", function, exchange.written, None)
        client.drain(until_ns)
        try:
            client.ask(asking, asking.request({}))
            answer = client.answer(until_ns)
        except (TransientError, DeviceFault):
            continue
        except LinkError:
            client.forgive()  # a unit that refuses in silence; a connection that is gone is met by what is sent next
            continue
        if answer is not None:
            found.update(zip(asking.inputs, asking.values(answer.pdu), strict=True))
    client.drain(until_ns)
    return found
