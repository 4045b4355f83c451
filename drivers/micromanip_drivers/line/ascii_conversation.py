"""Requests and replies by lines of text, where nothing in a reply says which request it answers.

So a reply counts only for the request that was sent just before it. Where one is missing, nothing else is asked until
it is sure that it can't come any more: the device is asked who it is, and since it answers in order, all that it says
before that answer is old. Such answers are counted, because the one to an earlier asking proves nothing of what was
asked after it. Where nothing is known that asks so, `drain_ms` have to pass, or the missing reply must come.
"""

from __future__ import annotations

import re
import time
from collections.abc import Iterator, Mapping, Sequence

from micromanip.driver import Answer, DeviceFault, IdentityMismatch, LinkError, StillOpening, TransientError

from . import ascii_presets
from .ascii_options import Ascii
from .ascii_text import Lines, Reply
from .framing import Silence
from .port import Port

_ASK_NS = 150_000_000
"""So long the device has to say who it is, before it is asked again."""

Numbers = tuple[Mapping[str, float], int]
"""The numbers of a reply by name, and when it came."""


class Conversation:
    """Speaks with one device."""

    def __init__(self, options: Ascii, port: Port, silence: Silence) -> None:
        self._options, self._port, self._silence = options, port, silence
        self._end = ascii_presets.terminator(options)
        self.who, pattern = ascii_presets.identity(options)
        self._pattern = re.compile(pattern) if pattern else None
        errors = ascii_presets.errors(options)
        self._good = errors.good if errors else ()
        self._error = Reply(errors.reply) if errors else None
        self._error_request = errors.request if errors else None
        self._lines = Lines()
        self._reply_ns, self._drain_ns = round(options.reply_ms * 1e6), round(options.drain_ms * 1e6)
        self._owed: Reply | None = None
        self._owed_until_ns = 0
        self._introductions_due = 0
        self._introduced = False
        self._look_for_errors = False
        self._counters = dict.fromkeys(("replies", "missing_replies", "late_lines", "wrong_replies", "held_back"), 0)

    @property
    def counters(self) -> Mapping[str, int]:
        """Since it was built."""
        return {**self._counters, "noise": self._lines.noise}

    @property
    def error_exchange(self) -> tuple[str, Reply] | None:
        """What is asked after each write, and the reply; None where the device tells by itself, or not at all."""
        return (self._error_request, self._error) if self._error_request and self._error else None

    def begin(self, deadline_ns: int) -> None:
        """On a port that was opened just now: who is it? Errors of before are forgotten.

        Raises LinkError where nothing answers, IdentityMismatch, DeviceFault where `start` is not understood.
        """
        self._lines.clear()
        self._owed, self._look_for_errors = None, False
        self._introductions_due = 0
        self._silence.heard(time.monotonic_ns(), more=False)
        if self._pattern is not None:
            self._identify(self._pattern, deadline_ns)
        try:
            if self.error_exchange is not None:
                self._error_code()
            for line in self._options.start:
                self.tell(line.encode() + self._end.encode(), line)
        except TransientError as problem:
            raise LinkError(str(problem)) from problem

    def introduced(self, wait_s: float, *, alone: bool) -> Iterator[Answer]:
        """What the device says when it is asked who it is, for so long; for a probe, which shows a wrong one too.

        `alone`: nothing else is asked, so that this is the value that counts.
        """
        if not self.who:
            return
        self._ask_who()
        answered = False
        for line, _ in self._come(time.monotonic_ns() + round(wait_s * 1e9)):
            answered, note = True, ""
            if self._pattern is not None:
                fits = self._is_introduction(line)
                note = "as configured" if fits else f'not the device of the configuration: "{self._pattern.pattern}"'
            yield Answer(self.who, {"reply": line}, note, is_value=alone)
        if not answered:
            note = f"no answer in {wait_s * 1e3:g} ms that is a line of text"
            yield Answer(self.who, {}, note, is_value=False)

    def is_held(self) -> bool:
        """Whether a reply of before may still come, so that nothing can be asked. Raises DeviceFault, LinkError."""
        now_ns = time.monotonic_ns()  # before it listens: what comes in a stall between the two was not silence
        self.listen(0)
        if self._owed is None:
            return False
        if now_ns >= self._owed_until_ns:
            if self._pattern is None or self._introduced:
                self._owed, self._introductions_due = None, 0
                return False
            self._ask_for_order(now_ns)
        self._counters["held_back"] += 1
        self._silence.check(now_ns)
        return True

    def ask(self, text: bytes, replies: Sequence[Reply], what: str) -> list[Numbers]:
        """Send `text`, whole lines, and take the `replies`. Raises TransientError, DeviceFault, LinkError."""
        if self._look_for_errors:
            self._look_for_errors = False
            self._judge(self._error_code(), "of before")
        return self._ask(text, replies, what)

    def tell(self, text: bytes, what: str, replies: Sequence[Reply] = ()) -> None:
        """Send `text`, which writes something, and look whether the device took it; raises as `ask`."""
        exchange = self.error_exchange
        if exchange is None:
            self.ask(text, replies, what)
            return
        request, reply = exchange
        numbers = self.ask(text + request.encode() + self._end.encode(), [*replies, reply], what)
        self._judge(numbers[-1][0]["code"], f"after {what}")

    def forgive(self, until_ns: int) -> None:
        """Put the line in order after a question that the device may not know, and forget the error of it.

        Raises DeviceFault, LinkError, TransientError.
        """
        while self.is_held() and time.monotonic_ns() < until_ns:
            self.listen(min(until_ns, time.monotonic_ns() + 1_000_000))
        self._look_for_errors = False
        if self.error_exchange is not None:
            self._error_code()

    def listen(self, until_ns: int) -> None:
        """Take what comes without being asked for, soon after the first. Raises DeviceFault, LinkError."""
        for line, time_ns in self._come(until_ns):
            self._stray(line, time_ns)

    def _ask(self, text: bytes, replies: Sequence[Reply], what: str) -> list[Numbers]:
        self._lines.clear()
        self._port.send(text)
        now_ns = time.monotonic_ns()
        if not replies:
            return []
        self._silence.expect(now_ns)
        numbers: list[Numbers] = []
        deadline_ns = now_ns + self._reply_ns
        while True:
            for line, time_ns in self._come(deadline_ns):
                self._is_no_error(line)
                if len(numbers) == len(replies):
                    self._is_introduction(line)
                    self._counters["late_lines"] += 1
                    continue
                found = replies[len(numbers)].readings(line)
                if found is not None:
                    numbers.append((found, time_ns))
                elif self._is_introduction(line):
                    self._counters["late_lines"] += 1  # it was asked twice who it is
                else:
                    self._lose(replies[-1])
                    self._counters["wrong_replies"] += 1
                    self._silence.misunderstood(line)
                    raise TransientError(
                        f'{self._port.name}: "{line}" came for {what}, not a line such as '
                        f'"{replies[len(numbers)].template}"'
                    )
            if len(numbers) == len(replies):
                self._counters["replies"] += 1
                self._silence.heard(numbers[-1][1], more=False)
                return numbers
            if time.monotonic_ns() >= deadline_ns:
                self._lose(replies[-1])
                self._counters["missing_replies"] += 1
                self._silence.check(time.monotonic_ns())
                raise TransientError(f"{self._port.name}: no reply to {what} within {self._reply_ns * 1e-6:g} ms")

    def _come(self, until_ns: int) -> list[tuple[str, int]]:
        """Lines that came, each with its time; soon after the first, and at `until_ns` at the latest."""
        while True:
            lines: list[tuple[str, int]] = []
            for data, time_ns in self._port.receive(until_ns):
                lines += [(line, time_ns) for line in self._lines.feed(data)]
                if self._port.datagrams:
                    self._lines.clear()
            if lines or time.monotonic_ns() >= until_ns:
                return lines

    def _lose(self, owed: Reply) -> None:
        """A reply is missing, or is not the one that was asked for: from now on, what comes may be late."""
        self._owed = owed
        self._look_for_errors = self.error_exchange is not None
        self._ask_for_order(time.monotonic_ns())

    def _ask_for_order(self, now_ns: int) -> None:
        self._lines.clear()
        self._owed_until_ns = now_ns + self._drain_ns
        self._introduced = False
        if self._pattern is not None:
            self._ask_who()

    def _ask_who(self) -> None:
        self._introductions_due += 1
        self._port.send((self.who + self._end).encode())

    def _is_introduction(self, line: str) -> bool:
        if self._pattern is None or self._pattern.search(line) is None:
            return False
        self._introductions_due = max(0, self._introductions_due - 1)
        return True

    def _stray(self, line: str, time_ns: int) -> None:
        self._is_no_error(line)
        self._counters["late_lines"] += 1
        introduction = self._is_introduction(line)
        if self._owed is None:
            return
        if introduction:
            self._silence.heard(time_ns, more=False)
            self._introduced = True
        if self._introduced:  # an answer may have been lost: then another, and `drain_ms` of silence, must do
            self._owed_until_ns = time_ns + self._drain_ns
        if self._pattern is None:
            in_order = self._owed.numbers(line) is not None
        else:
            in_order = introduction and self._introductions_due == 0
        if in_order:
            self._owed = None
            self._silence.heard(time_ns, more=False)

    def _is_no_error(self, line: str) -> None:
        if self._error is None or self._error_request is not None:
            return
        found = self._error.numbers(line)
        if found is not None:
            self._judge(found["code"], "by itself")

    def _error_code(self) -> float:
        exchange = self.error_exchange
        assert exchange is not None
        request, reply = exchange
        return self._ask((request + self._end).encode(), [reply], request)[0][0]["code"]

    def _judge(self, code: float, when: str) -> None:
        if code not in self._good:
            raise DeviceFault(
                f"{self._port.name} reports error {ascii_presets.meaning(self._options, int(code))} {when}"
            )

    def _identify(self, pattern: re.Pattern[str], deadline_ns: int) -> None:
        before = self._port.counters["bytes_in"]
        said: list[str] = []
        while (now_ns := time.monotonic_ns()) < deadline_ns:
            self._lines.clear()
            self._ask_who()
            until_ns = min(deadline_ns, now_ns + _ASK_NS)
            while time.monotonic_ns() < until_ns:
                for line, _ in self._come(until_ns):
                    if self._is_introduction(line):
                        return
                    said.append(line)
        if said and (len(set(said)) < len(said) or not self._port.may_be_starting):  # what it says once is a greeting
            raise IdentityMismatch(
                f'{self._port.name} answers {self.who} with "{said[-1]}"; it must match "{pattern.pattern}"'
            )
        lost = StillOpening if self._port.may_be_starting else LinkError
        if count := self._port.counters["bytes_in"] - before:
            raise lost(f"{self._port.name} sends {count} bytes that are no lines of text: is the baud rate right?")
        raise lost(f"{self._port.name} does not answer {self.who}: is it switched on, is the baud rate right?")
