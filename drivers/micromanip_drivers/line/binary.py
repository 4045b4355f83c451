"""The framing ``binary``: frames with sync bytes and checksum, that come by themselves or as answers."""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping, Sequence

from micromanip.driver import (
    Answer,
    Channel,
    ConfigError,
    Inbox,
    Load,
    Outcome,
    Steady,
    Task,
    TransientError,
)

from .binary_messages import FrameKinds, Frames, IdentityFrame, ReceivedFrame, SentFrame
from .binary_options import Binary
from .frame_reader import FrameReader, FrameSearch
from .framing import Framing, LineTime, Silence, Traffic
from .port import Port
from .steady_line import Heading, SteadyLine


class BinaryFraming(Framing):
    """Each message that is sent is a task."""

    def __init__(self, options: Binary, port: Port, line_time: LineTime, silence: Silence) -> None:
        self._options, self._port, self._silence = options, port, silence
        frames = Frames(options)
        inputs: list[Channel] = []
        outputs: list[Channel] = []
        received: dict[str, ReceivedFrame] = {}
        self._sent: list[SentFrame] = []
        for name, one in options.receive.items():
            received[name] = ReceivedFrame(frames, name, one, len(inputs), line_time)
            inputs += received[name].channels
        for name, other in options.send.items():
            self._sent.append(SentFrame(frames, name, other, len(outputs), line_time))
            outputs += self._sent[-1].channels
        self.inputs, self.outputs = inputs, outputs
        self.tasks: Sequence[Task] = [Task(sent.name, sent.rate_hz, sent.indices) for sent in self._sent]
        self._messages = list(received.values())
        self._answers = [_answer(sent, options.send[sent.name].reply, received) for sent in self._sent]
        self._by_itself = [message for message in self._messages if message not in self._answers]
        self.speaks_hz = max((message.rate_hz for message in self._by_itself), default=None)
        self._identity = IdentityFrame(frames, options.identity) if options.identity else None
        self._kinds = FrameKinds(options, self._messages, self._identity)
        self._reader = FrameReader(port, FrameSearch(frames.sync, self._kinds.length, options.crc))
        self.loads: Sequence[Load] = line_time.loads([*self._traffic(line_time, options.turnaround_us * 1e-6)])
        self._reply_ns, self._drain_ns = round(options.reply_ms * 1e6), round(options.drain_ms * 1e6)
        self._asking = self._identity.request if self._identity else b""
        self._identity_kind = options.identity.kind if options.identity else None
        self._is_owed, self._owed_until_ns = False, 0
        self._line = SteadyLine(self._reader, port, silence)
        self._counters = dict.fromkeys(("frames", "not_ours", "missing_answers", "late_answers", "held_back"), 0)

    def begin(self, deadline_ns: int) -> None:
        self._forget()
        if self._asking:
            self._reader.first(deadline_ns, self._is_another, "does not say who it is", self._asking)
        elif self._by_itself:
            heard = lambda frame: () if self._kinds.message(frame) else None  # noqa: E731
            self._reader.first(deadline_ns, heard, "sends nothing")
        self._reader.pardon()
        self._silence.heard(time.monotonic_ns(), more=bool(self._by_itself))
        self._line.lend()

    def end(self) -> None:
        self._line.forget()

    def perform(self, task: int, values: Sequence[float], inbox: Inbox) -> Outcome | None:
        with self._line.in_python("send_error", "writing"):
            return self._perform(task, values, inbox)

    def _perform(self, task: int, values: Sequence[float], inbox: Inbox) -> Outcome | None:
        sent, answer = self._sent[task], self._answers[task]
        frame = sent.frame(values)
        if answer is None:
            self._port.send(frame)
            sent.was_sent()
            if not (sent.indices and self._by_itself):
                return None
            self._line.unheard.add(task)
            return Outcome.SENT
        self._take(0, inbox)
        if self._is_held():
            self._counters["held_back"] += 1
            self._silence.check(time.monotonic_ns())
            return Outcome.HELD
        self._port.send(frame)
        sent.was_sent()
        self._await(sent, answer, inbox)
        return None

    def receive(self, inbox: Inbox, until_ns: int) -> None:
        with self._line.in_python("receive_error", "reading"):
            newest_ns = self._take(until_ns, inbox)
            self._silence.check(newest_ns or time.monotonic_ns())
            self._reader.complain()

    def steady(self) -> Steady | None:
        says_who = {self._identity_kind} if self._asking else set()  # frames of that kind have no samples
        if any(self._answers) or any(one.kind in says_who for one in self._messages):
            return None
        options = self._options
        heading = Heading(bytes.fromhex(options.sync), self._kinds.header, options.kind, options.length, options.crc)
        return self._line.begin(heading, self._messages, self._sent)

    def probe(self, seconds: float) -> Iterator[Answer]:
        self._forget()
        asking = [self._asking] if self._asking else []
        for sent, answer in zip(self._sent, self._answers, strict=True):
            if answer is not None and not sent.indices:
                asking.append(sent.frame([0.0] * len(self.outputs)))
        return self._reader.all_of(self._described, asking, seconds)

    @property
    def counters(self) -> Mapping[str, int]:
        counters = [message.counter for message in self._messages if message.counter]
        return {
            **self._counters,
            "frames": self._counters["frames"] + self._line.frames,
            **self._reader.counters,
            "lost": sum(counter.lost for counter in counters),
            "not_fresh": sum(counter.stale for counter in counters),
            "restarts": sum(counter.restarts for counter in counters),
        }

    def _forget(self) -> None:
        self.end()
        self._reader.forget()
        self._is_owed = False
        for message in self._messages:
            if message.counter:
                message.counter.forget()

    def _is_held(self) -> bool:
        """Whether an answer of before may still come, and be taken for that of the next question."""
        now_ns = time.monotonic_ns()
        if self._is_owed and now_ns >= self._owed_until_ns:
            self._is_owed = bool(self._asking)
            self._ask_for_order(now_ns)
        return self._is_owed

    def _ask_for_order(self, now_ns: int) -> None:
        """Ask who it is, where that can be asked: it answers in order, so what comes before that answer is old."""
        self._owed_until_ns = now_ns + self._drain_ns
        if self._asking:
            self._port.send(self._asking)

    def _take(self, until_ns: int, inbox: Inbox) -> int:
        """Take what came; when its newest part came, 0 if there was none."""
        frames = self._reader.frames(until_ns)
        for frame, time_ns in frames:
            message = self._kinds.message(frame)
            if message is not None and message in self._answers:
                self._counters["late_answers"] += 1
                self._is_owed = False  # nothing else was asked meanwhile: it is the one that was missing
            elif self._asking and self._kinds.kind(frame) == self._identity_kind:
                self._is_owed = False  # the one that was missing is lost
            else:
                self._take_one(message, frame, time_ns, inbox)
        return frames[-1][1] if frames else 0

    def _take_one(self, message: ReceivedFrame | None, frame: bytes, time_ns: int, inbox: Inbox) -> None:
        if message is None:
            self._counters["not_ours"] += 1
        elif message.take(frame, time_ns, inbox):
            self._counters["frames"] += 1
            self._silence.heard(time_ns, more=bool(self._by_itself))
            if message in self._by_itself:
                self._confirm(inbox)

    def _confirm(self, inbox: Inbox) -> None:
        """A device that acknowledges nothing has what was sent, as far as anybody can tell, while it is heard."""
        for task in self._line.unheard:
            inbox.confirm(task)
        self._line.unheard.clear()

    def _await(self, sent: SentFrame, answer: ReceivedFrame, inbox: Inbox) -> None:
        """Take the answer to what was sent just now. Raises TransientError where it is missing."""
        now_ns = time.monotonic_ns()
        deadline_ns = now_ns + self._reply_ns
        self._silence.expect(now_ns)
        bad, answered = self._reader.counters["bad_frames"], False
        while True:
            for frame, time_ns in self._reader.frames(deadline_ns):
                message = self._kinds.message(frame)
                answered = answered or message is answer
                self._take_one(message, frame, time_ns, inbox)
            self._reader.pardon()
            if answered:
                return
            if time.monotonic_ns() >= deadline_ns:
                break
        self._reader.forget()
        self._is_owed = True
        self._ask_for_order(time.monotonic_ns())
        self._counters["missing_answers"] += 1
        self._silence.check(time.monotonic_ns())
        how = "was damaged" if self._reader.counters["bad_frames"] > bad else "did not come"
        raise TransientError(
            f"{self._port.name}: {answer.name}, the answer to {sent.name}, {how} within {self._reply_ns * 1e-6:g} ms"
        )

    def _is_another(self, frame: bytes) -> Sequence[str] | None:
        """What a frame says of another device; None where it does not say who it is."""
        identity = self._identity
        if identity is None or self._kinds.kind(frame) != identity.kind:
            return None
        return identity.mismatches(frame)

    def _described(self, frame: bytes) -> Answer:
        message, kind = self._kinds.message(frame), self._kinds.kind(frame)
        values: dict[str, object] = {} if kind is None else {"kind": f"{kind:#04x}"}
        values["data"] = frame.hex(" ")
        note, another = "", self._is_another(frame)
        if self._identity is not None and another is not None:
            note = " and ".join(another) or "the device of the configuration"
            values |= self._identity.values(frame)
        if message is not None:
            return Answer(message.name, {**values, "status": message.status(frame), **message.values(frame)}, note)
        if note:
            return Answer("identity", values, note)
        return Answer(f"frame of kind {kind}", values, "not in the configuration", is_value=False)

    def _traffic(self, line_time: LineTime, turnaround_s: float) -> Iterator[Traffic]:
        for message in self._by_itself:
            yield Traffic(message.name, message.rate_hz, message.seconds, "in")
        for sent, answer in zip(self._sent, self._answers, strict=True):
            if answer is None:
                yield Traffic(sent.name, sent.rate_hz, sent.seconds, "out")
            else:
                seconds = line_time.turnaround_s + sent.seconds + turnaround_s + answer.seconds
                yield Traffic(sent.name, sent.rate_hz, seconds, "both")


def _answer(sent: SentFrame, name: str | None, received: Mapping[str, ReceivedFrame]) -> ReceivedFrame | None:
    """The message that answers; raises ConfigError where there is no such one, or its rate is another."""
    if name is None:
        return None
    key = f"binary.send.{sent.name}.reply"
    if name not in received:
        raise ConfigError(f"{key}: binary.receive has no {name}; it has {', '.join(received) or 'nothing'}")
    if received[name].rate_hz != sent.rate_hz:
        raise ConfigError(
            f"{key}: {name} has the rate {received[name].rate_hz:g} Hz, what it answers {sent.rate_hz:g} Hz"
        )
    return received[name]
