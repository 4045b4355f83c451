"""Keys of the framing ``ascii``: lines of text, a request and its reply (``docs/line.md``).

`command` and the axes' names on the device (`item`) are for a preset; any other device is described by templates. What
stands in braces is a field, blanks around a line's text do not matter.
"""

from __future__ import annotations

import re
from typing import Annotated, Literal, Self

from pydantic import AfterValidator, Field, field_validator, model_validator

from micromanip.driver import Commanded, Scaled, Section, Written
from micromanip.driver.quantities import Latency, Range, SampleRate

from .frame_options import Name


def _printable(text: str) -> str:
    if not text.isascii() or not text.isprintable():
        raise ValueError(f"{text!r} must be printable ASCII, without the terminator")
    return text


def _compiled(text: str) -> str:
    try:
        re.compile(text)
    except re.error as problem:
        raise ValueError(f"{text!r} is not a regular expression: {problem}") from None
    return text


Text = Annotated[str, Field(min_length=1), AfterValidator(_printable)]
Pattern = Annotated[str, Field(min_length=1), AfterValidator(_compiled)]
_PLACE = re.compile(r"\{(\w*)\}")


class AsciiIdentity(Section):
    """The device that must answer, asked at the start."""

    request: Text | None = Field(default=None, description="Request; null: the preset's, *IDN? of gcs.")
    pattern: Pattern = Field(description="Regular expression that must match in the answer.")


class Errors(Section):
    """The device's error report."""

    request: Text | None = Field(
        default=None, description="Request after each write and each missing reply; null: the device reports by itself."
    )
    reply: Text = Field(default="{code}", description="Template of the report, with the number as {code}.")
    good: tuple[Annotated[int, Field(strict=True)], ...] = Field(
        default=(0,), description="Numbers that mean no error."
    )


class AsciiInput(Scaled):
    """A value from the device."""

    item: str = Field(
        default="",
        pattern=r"^[\w.+-]*$",
        description="The device's name of the axis or channel, for a preset's templates.",
    )


class AsciiOutput(Commanded, AsciiInput):
    """A value to the device."""

    decimals: Annotated[int, Field(strict=True, ge=0, le=12)] = Field(default=4, description="Digits after the point.")
    range: Range = Field(default=(-1e6, 1e6), description="Lowest and highest value that may be sent.")


class _Exchange(Section):
    rate_hz: SampleRate = Field(description="Rate of the exchange.")
    command: Text | None = Field(default=None, description="Command of the preset: POS?, SVA, set.")
    request: Text | None = Field(default=None, description="Template of the line to send, in place of a command.")
    reply: tuple[Text, ...] = Field(default=(), description="Templates of the lines of the answer.")
    latency_us: Latency | None = Field(
        default=None,
        description="Read: from measurement to the reply's end. Write: from sending until the value acts. null: the "
        "exchange's time on the wire.",
    )

    @model_validator(mode="after")
    def _either_command_or_request(self) -> Self:
        if (self.command is None) == (self.request is None):
            raise ValueError("give either command, for a preset, or request")
        if self.command is not None and self.reply:
            raise ValueError("reply goes with request; the preset knows the replies to a command")
        return self


class Read(_Exchange):
    """Values requested at a fixed rate."""

    fields: dict[Name, AsciiInput] = Field(min_length=1, description="The inputs by name.")
    no_reading: tuple[Text, ...] = Field(
        default=(),
        description="What the device says without a reading, in place of a number or as one: a bad sample. Known "
        "without this: nan, inf, OVL, ----- and the like, and any word in a reply with more text than the number.",
    )

    @model_validator(mode="after")
    def _fields_are_answered(self) -> Self:
        if self.request is not None:
            _must_have(places("".join(self.reply)), set(self.fields), "reply")
            _must_have(places(self.request), set(), "request")
        return self


class Write(_Exchange, Written):
    """Values sent at a fixed rate."""

    fields: dict[Name, AsciiOutput] = Field(min_length=1, description="The outputs by name.")

    @model_validator(mode="after")
    def _fields_are_sent(self) -> Self:
        if self.request is not None:
            _must_have(places(self.request), set(self.fields), "request")
            _must_have(places("".join(self.reply)), set(), "reply")
        return self


class Ascii(Section):
    """Lines of text."""

    preset: Literal["gcs", "command,value"] | None = Field(
        default=None, description="Known templates: GCS 2.0, or lines such as set,0,12.3; null: none."
    )
    terminator: Literal["LF", "CR", "CRLF"] | None = Field(
        default=None,
        description="End of the lines sent; received lines may end in any of them. null: the preset's, LF of gcs, CR "
        "of command,value.",
    )
    identity: AsciiIdentity | None = Field(
        default=None,
        description="The device that must answer: request and pattern, or the pattern alone. null: any.",
    )
    errors: Errors | None = Field(
        default=None, description="Error reports; null: the preset's, ERR? of gcs, err,1 of command,value."
    )
    reply_ms: Annotated[float, Field(strict=True, gt=0, le=250)] = Field(
        default=50.0, description="Longest time of a reply; then it is missing."
    )
    drain_ms: Annotated[float, Field(strict=True, gt=0, le=5_000)] = Field(
        default=100.0,
        description="Silence after a missing reply, for a late one; longer than the device's longest reply time.",
    )
    turnaround_us: Latency = Field(default=0.0, description="The device's time until its reply begins, for the budget.")
    digits: Annotated[int, Field(strict=True, ge=1, le=40)] = Field(
        default=14, description="Characters of the longest number in a reply, for the budget."
    )
    start: tuple[Text, ...] = Field(
        default=(),
        description="Lines sent at the start; they must move nothing and have no answer.",
    )
    read: dict[Name, Read] = Field(default={}, description="Requests, by any name.")
    write: dict[Name, Write] = Field(default={}, description="Writes, by any name.")

    @field_validator("identity", mode="before")
    @classmethod
    def _pattern_alone(cls, given: object) -> object:
        return {"pattern": given} if isinstance(given, str) else given

    @model_validator(mode="after")
    def _does_something(self) -> Self:
        if not self.read and not self.write:
            raise ValueError("read or write: at least one exchange must be given")
        return self

    @model_validator(mode="after")
    def _has_what_a_preset_would_give(self) -> Self:
        if self.preset is None:
            if self.terminator is None:
                raise ValueError("terminator must be given where there is no preset")
            for key, exchanges in (("read", self.read), ("write", self.write)):
                for name, exchange in exchanges.items():
                    if exchange.command is not None:
                        raise ValueError(
                            f"{key}.{name}: command goes with a preset; without one give request and reply"
                        )
        if self.preset != "gcs" and self.identity is not None and self.identity.request is None:
            raise ValueError("identity: give request and pattern; only the preset gcs knows a request")
        return self


def places(template: str) -> list[str]:
    """Names in braces, in their order."""
    return _PLACE.findall(template)


def _must_have(found: list[str], wanted: set[str], key: str) -> None:
    for name in found:
        if name not in wanted:
            raise ValueError(
                f"{key}: {{{name}}} is not one of the fields it can hold: {', '.join(sorted(wanted)) or 'none'}"
            )
        if found.count(name) > 1:
            raise ValueError(f"{key}: {{{name}}} stands there twice")
    if missing := wanted - set(found):
        raise ValueError(f"{key}: {{{min(missing)}}} is missing: each field must stand there once")
