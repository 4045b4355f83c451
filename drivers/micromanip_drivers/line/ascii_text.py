"""Text on a line: templates of what is said and answered, and lines out of a stream of bytes."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence

from ..sent_number import ANY, sent_number
from .ascii_options import AsciiOutput

_PLACE = re.compile(r"\{(\w+)\}")
_NUMBER = r"\s*[+-]?\s*(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?"
"""Blanks around a sign are those of a field of fixed width."""
_WORD = r"[^\s\d,;](?:[^\d,;]*?[^\s\d,;])?|[+-]?1\.#\w+"
_NO_NUMBER = re.compile(r"[+-]?(?:nan|inf|1\.#\w+|ovld?|[-*#?.<>_~=]{2,})", re.IGNORECASE)
"""What stands for "no reading" where the line has nothing else that tells what it answers."""
_FLOW_CONTROL = b"\x11\x13"
"""XON and XOFF, which may come anywhere."""
_AROUND = bytes((*range(0x01, 0x09), *range(0x0B, 0x20), 0x7F))
"""Control characters that devices put before and behind a line: STX, ETX, ACK, ..."""
_LONGEST = 4096


class Reply:
    """A line that answers; what stands in braces is a number.

    `no_reading` are words that the device says in place of one.
    """

    def __init__(self, template: str, no_reading: Sequence[str] = ()) -> None:
        self.template, self._no_reading = template, no_reading
        *parts, last = _PLACE.split(template)  # text, name, text, name, ..., text
        pattern = worded = ""
        for at, (text, name) in enumerate(zip(parts[::2], parts[1::2], strict=True)):
            before = _escaped(text, after_number=at > 0, before_number=True)
            pattern += f"{before}(?P<{name}>{_NUMBER})"
            worded += f"{before}(?P<{name}>{_NUMBER}|\\s*(?:{'|'.join([*map(re.escape, no_reading), _WORD])}))"
        end = _escaped(last, after_number=True)
        self._pattern, self._worded = re.compile(pattern + end), re.compile(worded + end)
        self._names_itself = bool("".join([*parts[::2], last]).strip())

    def numbers(self, line: str) -> Mapping[str, float] | None:
        """The numbers of `line` by name; None for a line that is another one."""
        match = self._pattern.fullmatch(line)
        return None if match is None else {name: _value(text) for name, text in match.groupdict().items()}

    def readings(self, line: str) -> Mapping[str, float] | None:
        """The same; not a number where the device has a word, or a number of its own, for that it has no reading.

        Any word will do in a line with more text, such as "MS,-----" for "MS,{x}". Where a number is all there is, the
        word must be one of `no_reading`, or one that everybody knows, such as "nan" or "-----".
        """
        match = self._pattern.fullmatch(line) or self._worded.fullmatch(line)
        if match is None or not all(map(self._is_known, match.groupdict().values())):
            return None
        found = match.groupdict().items()
        return {name: math.nan if text.strip() in self._no_reading else _value(text) for name, text in found}

    def _is_known(self, text: str) -> bool:
        word = text.strip()
        known = word in self._no_reading or _NO_NUMBER.fullmatch(word) is not None
        return known or self._names_itself or re.fullmatch(_NUMBER, text) is not None

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
        texts = (
            max((_text(name, options, end) for end in options.range), key=len) for name, _, options in self._places
        )
        return len(self._format % tuple(texts)) + len(self._places)  # a sign that the ends of the range have not


def _text(name: str, options: AsciiOutput, value: float) -> str:
    number = sent_number(value, name, options.scale, options.offset, ANY, options.range, whole=False)
    return f"{number:.{options.decimals}f}"


def _value(text: str) -> float:
    """The number; not a number for a word."""
    return float("".join(text.split())) if re.fullmatch(_NUMBER, text) else math.nan


def _escaped(text: str, *, after_number: bool = False, before_number: bool = False) -> str:
    """The text as it is, but for the number of blanks.

    Between a number and what is no part of one there may be none: a field of fixed width may be full.
    """
    words = [re.escape(word) for word in re.split(r"\s+", text)]
    gaps = [r"\s+"] * (len(words) - 1)
    if after_number and words[0] == "" and len(words) > 1 and words[1] and not re.match(r"[\d.eE]", words[1]):
        gaps[0] = r"\s*"
    elif after_number and words[0] and not re.match(r"[\d.eE]", words[0]):
        words[0] = rf"\s*{words[0]}"
    if before_number and words[-1] == "" and len(words) > 1 and words[-2]:
        gaps[-1] = r"(?:\s+|(?=[+-]))"
    return words[0] + "".join(gap + word for gap, word in zip(gaps, words[1:], strict=True))


class Lines:
    """Lines end in a carriage return, a line feed, or both; blank ones are none. However the bytes are cut.

    Characters of flow control are passed over, others that control only before and behind a line.
    """

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
            text = line.translate(None, _FLOW_CONTROL).lstrip(b"\0").strip(b" \t" + _AROUND).decode("ascii", "replace")
            if not text:
                continue
            if text.isprintable() and text.isascii():
                lines.append(text)
            else:
                self.noise += 1
        return lines
