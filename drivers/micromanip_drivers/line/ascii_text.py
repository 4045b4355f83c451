"""Text on a line: templates of what is said and answered, and lines out of a stream of bytes."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence

from micromanip.driver import OutputRefused

from .ascii_options import AsciiOutput

_PLACE = re.compile(r"\{(\w+)\}")
_NUMBER = r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?"
_LONGEST = 4096


class Reply:
    """A line that answers; what stands in braces is a number."""

    def __init__(self, template: str) -> None:
        self.template = template
        *parts, last = _PLACE.split(template)  # text, name, text, name, ..., text
        pattern = ""
        for text, name in zip(parts[::2], parts[1::2], strict=True):
            pattern += f"{_escaped(text)}(?P<{name}>{_NUMBER})"
        self._pattern = re.compile(pattern + _escaped(last))

    def numbers(self, line: str) -> Mapping[str, float] | None:
        """The numbers of `line` by name; None for a line that is another one."""
        match = self._pattern.fullmatch(line)
        return None if match is None else {name: float(text) for name, text in match.groupdict().items()}

    def longest(self, digits: int) -> int:
        """Bytes that it has at most, with a blank and two characters for its end."""
        return len(_PLACE.sub("0" * digits, self.template)) + 3


class Request:
    """A line that is sent; what stands in braces is an output of `outputs`, at its index in the driver's values."""

    def __init__(self, template: str, outputs: Mapping[str, tuple[int, AsciiOutput]], terminator: str) -> None:
        self.template = template
        self._places = [(name, *outputs[name]) for name in _PLACE.findall(template)]
        self._format = _PLACE.sub("%s", template.replace("%", "%%")) + terminator

    def text(self, values: Sequence[float]) -> bytes:
        """What is sent for `values` of all outputs of the driver. Raises OutputRefused."""
        return (self._format % tuple(_text(name, options, values[at]) for name, at, options in self._places)).encode()

    @property
    def longest(self) -> int:
        """Bytes that it has at most."""
        texts = (max((_number(options, end) for end in options.range), key=len) for _, _, options in self._places)
        return len(self._format % tuple(texts)) + len(self._places)  # a sign that the ends of the range have not


def _text(name: str, options: AsciiOutput, value: float) -> str:
    if not math.isfinite(value):
        raise OutputRefused(f"{name} is {value}: nothing was sent")
    low, high = options.range
    if not low <= value <= high:
        raise OutputRefused(f"{name} is {value:g}, it may be {low:g} to {high:g}: nothing was sent")
    return _number(options, value)


def _number(options: AsciiOutput, value: float) -> str:
    return f"{(value - options.offset) / options.scale:.{options.decimals}f}"


def _escaped(text: str) -> str:
    """The text as it is, but for the number of blanks."""
    return r"\s+".join(re.escape(word) for word in re.split(r"\s+", text))


class Lines:
    """Lines end in a carriage return, a line feed, or both; blank ones are none. However the bytes are cut."""

    def __init__(self) -> None:
        self._rest = b""
        self.noise = 0
        """Lines that were no printable text, or too long."""

    def clear(self) -> None:
        """Forget what is there of a line."""
        self._rest = b""

    def feed(self, data: bytes) -> list[str]:
        """The lines that are complete with `data`, without blanks around them."""
        *whole, self._rest = (self._rest + data).replace(b"\r", b"\n").split(b"\n")
        if len(self._rest) > _LONGEST:
            self.noise += 1
            self._rest = b""
        lines = []
        for line in whole:
            text = line.strip().decode("ascii", "replace")
            if not text:
                continue
            if text.isprintable() and text.isascii():
                lines.append(text)
            else:
                self.noise += 1
        return lines
