"""The framing ``ascii``: lines of text, a request and its reply."""

from __future__ import annotations

import math
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

from micromanip.driver import Answer, Channel, DeviceFault, Inbox, Load, Outcome, Task, TransientError

from . import ascii_presets
from .ascii_conversation import Conversation
from .ascii_options import Ascii, AsciiOutput, Read, Write
from .ascii_text import Reply, Request
from .frame_options import BAD
from .framing import Framing, LineTime, Silence, Traffic
from .port import Port


@dataclass(frozen=True)
class Step:
    """A request and the lines that answer it."""

    request: Request
    replies: Sequence[Reply]


class Exchange:
    """A read or a write. Raises ConfigError.

    `first` is the index of its first channel among the driver's inputs, or outputs.
    """

    def __init__(self, options: Ascii, name: str, exchange: Read | Write, first: int, line_time: LineTime) -> None:
        self.name, self.rate_hz = name, exchange.rate_hz
        self.writes = isinstance(exchange, Write)
        key = f"ascii.{'write' if self.writes else 'read'}.{name}"
        if isinstance(exchange, Write):
            exchange.must_last(f"{key}.", exchange.rate_hz)
        self.indices = {label: index for index, label in enumerate(exchange.fields, first)}
        self.scales = {label: (field.scale, field.offset) for label, field in exchange.fields.items()}
        outputs: Mapping[str, tuple[int, AsciiOutput]] = {
            label: (self.indices[label], field)
            for label, field in exchange.fields.items()
            if isinstance(field, AsciiOutput)
        }
        end = ascii_presets.terminator(options)
        words = exchange.no_reading if isinstance(exchange, Read) else ()
        self.steps = [
            Step(Request(request, outputs, end), [Reply(line, words) for line in replies])
            for request, replies in ascii_presets.steps(options, key, exchange)
        ]
        asking = ascii_presets.read_back(options, exchange) if isinstance(exchange, Write) else None
        self.read_back = Step(Request(asking[0], {}, end), [Reply(line) for line in asking[1]]) if asking else None
        """What asks for the values that are written; None where nothing is known that does."""
        self.seconds, sent_s, told_s = self._times(options, line_time)
        known_s = None if exchange.latency_us is None else exchange.latency_us * 1e-6
        self.latency_s = known_s if known_s is not None else sent_s if self.writes else told_s
        safes = {label: field.safe for label, (_, field) in outputs.items()}
        self.channels = [
            Channel(label, exchange.rate_hz, self.latency_s, safes.get(label, 0.0)) for label in exchange.fields
        ]

    @property
    def title(self) -> str:
        """What messages call it: the requests that it makes."""
        return ", ".join(step.request.template.split("{")[0].strip(" ,=") for step in self.steps[:1])

    def _times(self, options: Ascii, line_time: LineTime) -> tuple[float, float, float]:
        """How long it keeps the line, its longest request, and its longest reply after the device's turnaround."""
        turnaround_s = options.turnaround_us * 1e-6
        errors = ascii_presets.errors(options)
        end = ascii_presets.terminator(options)
        total_s = longest_s = told_s = 0.0
        for step in self.steps:
            sent, told = step.request.longest, sum(reply.longest(options.digits) for reply in step.replies)
            if self.writes and errors is not None and errors.request is not None:
                sent += len(errors.request + end)
                told += Reply(errors.reply).longest(options.digits)
            answer_s = turnaround_s + line_time.seconds(told) if told else 0.0
            total_s += line_time.turnaround_s + line_time.seconds(sent) + answer_s
            longest_s, told_s = max(longest_s, line_time.seconds(sent)), max(told_s, answer_s)
        return total_s, longest_s, told_s


_PAUSE_S = 0.05
_FORGIVE_NS = 300_000_000


class AsciiFraming(Framing):
    """Each read and each write is a task."""

    def __init__(self, options: Ascii, port: Port, line_time: LineTime, silence: Silence) -> None:
        self._port, self._silence = port, silence
        inputs: list[Channel] = []
        outputs: list[Channel] = []
        self._exchanges: list[Exchange] = []
        for name, read in options.read.items():
            self._exchanges.append(Exchange(options, name, read, len(inputs), line_time))
            inputs += self._exchanges[-1].channels
        for name, write in options.write.items():
            self._exchanges.append(Exchange(options, name, write, len(outputs), line_time))
            outputs += self._exchanges[-1].channels
        self.inputs, self.outputs = inputs, outputs
        self.tasks: Sequence[Task] = [
            Task(one.name, one.rate_hz, tuple(one.indices.values()) if one.writes else ()) for one in self._exchanges
        ]
        self.loads: Sequence[Load] = line_time.loads(
            [Traffic(one.name, one.rate_hz, one.seconds, "both") for one in self._exchanges]
        )
        self._conversation = Conversation(options, port, silence)

    def begin(self, deadline_ns: int) -> None:
        self._conversation.begin(deadline_ns)

    def perform(self, task: int, values: Sequence[float], inbox: Inbox) -> Outcome | None:
        exchange = self._exchanges[task]
        texts = [step.request.text(values) for step in exchange.steps] if exchange.writes else []
        if self._conversation.is_held():
            return Outcome.HELD
        if exchange.writes:
            for step, text in zip(exchange.steps, texts, strict=True):
                self._conversation.tell(text, exchange.title, step.replies)
            return None
        for name, value, time_ns in self._asked(exchange):
            status = 0 if math.isfinite(value) else BAD
            inbox.put(exchange.indices[name], value, time_ns - round(exchange.latency_s * 1e9), status)
        return None

    def read_outputs(self) -> Sequence[float | None]:
        """What is written is asked for where the preset knows how; a device may not, and complain of it."""
        found: list[float | None] = [None] * len(self.outputs)
        for exchange in self._exchanges:
            if exchange.read_back is None:
                continue
            try:
                for name, value, _ in self._asked(exchange, [exchange.read_back]):
                    found[exchange.indices[name]] = value if math.isfinite(value) else None
            except (TransientError, DeviceFault):
                self._conversation.forgive(time.monotonic_ns() + _FORGIVE_NS)
        return found

    def receive(self, inbox: Inbox, until_ns: int) -> None:  # noqa: ARG002 (nothing of it is a sample)
        self._conversation.listen(until_ns)
        self._silence.check(time.monotonic_ns())

    def probe(self, seconds: float) -> Iterator[Answer]:
        reads = [exchange for exchange in self._exchanges if not exchange.writes]
        yield from self._conversation.introduced(_PAUSE_S, alone=not reads)
        end_ns = time.monotonic_ns() + round(seconds * 1e9)
        while reads and time.monotonic_ns() < end_ns:
            for exchange in reads:
                try:
                    while self._conversation.is_held():
                        time.sleep(0.001)
                    values = {name: value for name, value, _ in self._asked(exchange)}
                except (TransientError, DeviceFault) as problem:
                    yield Answer(exchange.title, {}, str(problem), is_value=False)
                else:
                    yield Answer(exchange.title, values)
            time.sleep(_PAUSE_S)

    @property
    def counters(self) -> Mapping[str, int]:
        return self._conversation.counters

    def _asked(self, exchange: Exchange, steps: Sequence[Step] | None = None) -> Iterator[tuple[str, float, int]]:
        """Name, value and time of reception of what is read, step by step."""
        for step in exchange.steps if steps is None else steps:
            for numbers, time_ns in self._conversation.ask(step.request.text(()), step.replies, exchange.title):
                for name, number in numbers.items():
                    scale, offset = exchange.scales[name]
                    yield name, number * scale + offset, time_ns
