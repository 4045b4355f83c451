"""Exchanges of the framing ``ascii``: what the configuration says of one, made ready to be spoken."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from micromanip.driver import Channel

from . import ascii_presets
from .ascii_options import Ascii, AsciiOutput, Read, Write
from .ascii_text import Reply, Request
from .line_time import LineTime


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
