"""Requests and answers on one line: one at a time, and no late answer is taken for another's.

Modbus RTU has no transaction number: one late answer, and every later one would be that to the request before. So after
a time-out the line is kept silent, and what comes is thrown away, until nothing has come for longer than the latest
answer of any device (``drain_ms``), or until the late answer itself has come: nothing else is under way then. On a
serial line that is believed once; a second time-out in a row waits for the silence, whatever comes. Over TCP, where the
number tells, the silence begins with the second time-out in a row: it keeps requests from gathering in a device that
hangs.

The receive loop is our own, on the ports of the driver `line`: the library's client blocks for its time-outs, and goes
on after one as if nothing could come any more.
"""

from __future__ import annotations

import contextlib
import time
from collections.abc import Mapping
from dataclasses import dataclass

from micromanip.driver import LinkError, StillOpening, TransientError

from ..line.port import Port
from ..line.serial_port import SerialLine
from ..line.tcp_port import TcpConnection
from .exchange import Exchange
from .framing import EXCEPTION_BYTES, BadFrame, DamagedFrame, Framing, RtuFraming, TcpFraming, exception_error
from .options import ModbusOptions
from .plan import Timing

_TIMEOUTS = 3
"""So many in a row are a lost link."""
_UNACKNOWLEDGED_MS, OPEN_NS = 1000.0, 900_000_000


@dataclass(frozen=True)
class Answer:
    """What came for a request, from the function code on."""

    exchange: Exchange
    pdu: bytes
    asked: bytes
    """The request, likewise."""
    sent_ns: int
    received_ns: int


@dataclass(frozen=True)
class _Request:
    exchange: Exchange
    pdu: bytes
    frame: bytes
    head: bytes
    sent_ns: int
    deadline_ns: int


class Client:
    """One line and its one request."""

    def __init__(self, options: ModbusOptions, timing: Timing) -> None:
        self._framing: Framing
        self._port: Port
        if options.serial is not None:
            self._framing, self._port = RtuFraming(), SerialLine(options.serial)
        else:
            assert options.tcp is not None
            self._framing, self._port = TcpFraming(), TcpConnection(options.tcp, _UNACKNOWLEDGED_MS)
        self._serial = options.serial is not None
        drain_ms = 3.0 * options.timeout_ms if options.drain_ms is None else options.drain_ms
        self._timeout_ns, self._drain_ns = round(options.timeout_ms * 1e6), round(drain_ms * 1e6)
        self._gap_ns = round(timing.gap_s * 1e9)
        self._buffer = bytearray()
        self._request: _Request | None = None
        self._overdue: _Request | None = None
        """The one whose late answer would end the silence."""
        self._silent_until_ns = self._silence_ns = self._heard_ns = 0
        self._asked_before: dict[int, bytes] = {}
        """The request before the newest one of each transaction that writes."""
        self._newest: dict[int, bytes] = {}
        self._timeouts = 0
        self._counters = dict.fromkeys(("requests", "answers", "timeouts", "bad_frames", "exceptions", "resyncs"), 0)

    @property
    def may_be_starting(self) -> bool:
        """Whether the device may need more time since its line was opened: nothing of it was heard yet."""
        return self._port.may_be_starting and self._heard_ns < self._port.opened_ns

    @property
    def waits(self) -> bool:
        """Whether a request is out whose time is not over."""
        return self._request is not None

    def open(self, deadline_ns: int) -> None:
        """Reach the line; a serial one is listened to until it is silent. Raises LinkError.

        Raises StillOpening where it has to be called again; a line that is open is not opened anew then.
        """
        if self._port.descriptor < 0:
            self.close()
            self._connect(deadline_ns)
        self._port.settle(deadline_ns)
        self._timeouts = 0
        if self._serial:
            self._be_silent(time.monotonic_ns() + self._drain_ns, self._drain_ns)
            self.drain(deadline_ns)

    def reach(self) -> None:
        """Open it, however long it takes to be ready. Raises LinkError."""
        while True:
            with contextlib.suppress(StillOpening):
                return self.open(time.monotonic_ns() + OPEN_NS)

    def close(self) -> None:
        """Let go of it; does no harm twice, never raises."""
        self._port.close()
        self._buffer.clear()
        self._request = self._overdue = None
        self._silent_until_ns = 0

    def drain(self, until_ns: int) -> None:
        """Listen until the line may be used again, and at most so long. Raises LinkError."""
        while (now_ns := time.monotonic_ns()) < min(self._silent_until_ns, until_ns):
            self._idle(min(self._silent_until_ns, until_ns), now_ns)

    def forgive(self) -> None:
        """Go on after a unit that need not answer: its time-outs are not those of the next one."""
        self._request, self._timeouts = None, 0
        if self._serial:
            self._be_silent(time.monotonic_ns() + self._drain_ns, self._drain_ns)

    def is_silent(self) -> bool:
        """Whether the line is kept silent. Raises LinkError."""
        now_ns = time.monotonic_ns()
        if now_ns < self._silent_until_ns:
            self._idle(now_ns, now_ns)
        return now_ns < self._silent_until_ns

    def ask(self, exchange: Exchange, pdu: bytes) -> None:
        """Send a request; there must be none out. Raises TransientError while the line is kept silent, LinkError."""
        now_ns = time.monotonic_ns()
        if self._serial or now_ns < self._silent_until_ns:  # over TCP, what is late is told by its number
            self._idle(now_ns, now_ns)
        if now_ns < self._silent_until_ns:
            left_ms = (self._silent_until_ns - now_ns) * 1e-6
            raise TransientError(f"{exchange.title}: not sent: late answers are waited for, {left_ms:.0f} ms more")
        if self._overdue is not None:
            self._overdue = None
            self._framing.idle(self._buffer)
        if self._serial and (wait_ns := self._heard_ns + self._gap_ns - now_ns) > 0:
            time.sleep(wait_ns * 1e-9)
        frame = self._framing.seal(exchange.unit_id, pdu)
        sent_ns = time.monotonic_ns()
        self._port.send(frame)
        self._counters["requests"] += 1
        if exchange.written is not None:
            self._asked_before[id(exchange)] = self._newest.get(id(exchange), b"")
            self._newest[id(exchange)] = pdu
        self._request = _Request(exchange, pdu, frame, exchange.answer_head(pdu), sent_ns, sent_ns + self._timeout_ns)

    def answer(self, until_ns: int) -> Answer | None:
        """The answer, as soon as it is there; None at `until_ns` without one.

        Raises TransientError for a time-out and for what is no answer, DeviceFault for an exception, LinkError.
        """
        request = self._request
        if request is None:
            self._idle(until_ns, time.monotonic_ns())
            return None
        while True:
            self._listen(min(until_ns, request.deadline_ns))
            try:
                exchange = request.exchange
                pdu = self._framing.take(self._buffer, exchange.unit_id, request.head, exchange.answer_bytes)
            except BadFrame as problem:
                self._request = None
                raise self._refused(request, problem) from problem
            if pdu is not None:
                self._request = None
                return self._accepted(request, pdu)
            now_ns = time.monotonic_ns()
            if now_ns >= request.deadline_ns:
                self._request = None
                self._timed_out(request, now_ns)
            if now_ns >= until_ns:
                return None

    def _connect(self, until_ns: int) -> None:
        self._port.open(until_ns)
        self._framing.in_doubt = False
        if not self._serial:  # a device that is deaf at first would take the next requests for nothing
            self._be_silent(self._port.opened_ns + self._port.settle_ns, 0)

    def statistics(self) -> Mapping[str, int]:
        """Counters since ``__init__``."""
        return {
            **self._counters,
            "late": self._framing.late,
            "stray_bytes": self._framing.stray_bytes,
            **self._port.counters,
        }

    def _accepted(self, request: _Request, pdu: bytes) -> Answer:
        self._timeouts = 0
        if len(pdu) == EXCEPTION_BYTES and pdu[0] & 0x80:
            self._counters["exceptions"] += 1
            raise exception_error(request.exchange.title, pdu[1])
        if self._serial and request.exchange.refusal(request.pdu, pdu) and self._is_of_before(request, pdu):
            raise self._refused(request, BadFrame("it is the answer to the write before"))
        self._counters["answers"] += 1
        return Answer(request.exchange, pdu, request.pdu, request.sent_ns, self._heard_ns)

    def _is_of_before(self, request: _Request, pdu: bytes) -> bool:
        return self._asked_before.get(id(request.exchange), b"")[: len(pdu)] == pdu

    def _refused(self, request: _Request, problem: BadFrame) -> TransientError:
        self._counters["bad_frames"] += 1
        what = f"{request.exchange.title}: no answer but something else: {problem}"
        if self._serial and bytes(self._buffer).startswith(request.frame):
            what += "; what is sent comes back: if the adapter has such an echo, say rs485: {echo: true}"
        if not isinstance(problem, DamagedFrame):
            self._resynchronise(request)
        return TransientError(what)

    def _resynchronise(self, request: _Request) -> None:
        """Find the place again where an answer begins. Raises LinkError where a connection can't be had again."""
        self._counters["resyncs"] += 1
        self._buffer.clear()
        if self._serial:  # the true answer may still come, until it is late; what comes after that is not waited for
            self._be_silent(request.deadline_ns, self._gap_ns)
        else:
            self._connect(time.monotonic_ns() + self._timeout_ns)

    def _timed_out(self, request: _Request, now_ns: int) -> None:
        self._counters["timeouts"] += 1
        self._framing.in_doubt = True
        text = f"{request.exchange.title}: no answer within {self._timeout_ns * 1e-6:g} ms"
        if self._buffer:
            text += f", only {len(self._buffer)} bytes of one"
        else:
            self._timeouts += 1
        advice = "look at power, wires and the number of the unit"
        if self._framing.came:
            text, advice = f"{text}: {self._framing.came}", "is it a Modbus TCP device?"
        if self._timeouts >= _TIMEOUTS:
            raise LinkError(f"{text}, {_TIMEOUTS} times in a row; {advice}")
        if self._serial:
            self._counters["resyncs"] += 1
            self._overdue = request if self._timeouts == 1 and not self._buffer else None
            self._buffer.clear()
        if self._serial or self._timeouts > 1:
            self._be_silent(now_ns + self._drain_ns, self._drain_ns)
        raise TransientError(text)

    def _came_late(self, request: _Request) -> bool:
        """Whether the answer to a request that is over has come: then nothing more is under way."""
        exchange = request.exchange
        try:
            pdu = self._framing.take(self._buffer, exchange.unit_id, request.head, exchange.answer_bytes)
        except BadFrame:
            self._overdue = None
            return False
        if pdu is not None:
            self._framing.late += 1
            self._overdue, self._silent_until_ns = None, 0
        return pdu is not None

    def _be_silent(self, until_ns: int, after_ns: int) -> None:
        """Send nothing until then, and until nothing has come for `after_ns`."""
        self._silent_until_ns, self._silence_ns = until_ns, after_ns

    def _listen(self, until_ns: int) -> None:
        for data, time_ns in self._port.receive(until_ns):
            self._buffer += data
            self._heard_ns = time_ns

    def _idle(self, until_ns: int, now_ns: int) -> None:
        """Listen with no request out: what comes is nobody's."""
        before = self._heard_ns
        self._listen(until_ns)
        if self._overdue is not None and self._came_late(self._overdue):
            return
        late = self._framing.late
        try:
            if self._overdue is None:
                self._framing.idle(self._buffer)
        except BadFrame:
            self._counters["bad_frames"] += 1
            self._counters["resyncs"] += 1
            self._buffer.clear()
            self._connect(time.monotonic_ns() + self._timeout_ns)
        if self._serial and self._heard_ns != before and now_ns < self._silent_until_ns:
            self._silent_until_ns = max(self._silent_until_ns, self._heard_ns + self._silence_ns)
        elif not self._serial and self._framing.late > late:
            self._silent_until_ns = 0
