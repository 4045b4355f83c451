"""The framing `binary`: answers, kinds, status, silence."""

import random
import struct
import time

import pytest
from micromanip_drivers.line.binary import BinaryFraming
from micromanip_drivers.line.binary_options import Binary
from micromanip_drivers.line.driver import Line
from micromanip_drivers.line.framing import LineTime, Silence
from micromanip_drivers.line.options import TcpPort

from micromanip.bus.driver import Outcome
from micromanip.bus.errors import IdentityMismatch, LinkError, TransientError
from micromanip.bus.inbox import Inbox

from .board import FRAMING, Board, frame
from .scripted_port import ScriptedPort
from .wires import PtyWire

COUNTER = {"at": 4, "type": "uint16", "byte_order": "little"}
ASKED = {
    **{key: FRAMING["binary"][key] for key in ("sync", "length", "kind", "crc")},
    "reply_ms": 4.0,
    "drain_ms": 12.0,
    "receive": {
        "gauge": {
            "kind": 0x91,
            "rate_hz": 500,
            "fields": {"strain": {"at": 4, "type": "int16", "byte_order": "big", "scale": 0.5}},
        },
        "state": {
            "kind": 0x92,
            "rate_hz": 500,
            "counter": COUNTER,
            "fields": {"temperature": {"at": 6, "type": "int8"}},
        },
    },
    "send": {
        "ask": {"kind": 0x11, "rate_hz": 500, "reply": "gauge"},
        "move": {
            "kind": 0x12,
            "rate_hz": 500,
            "reply": "state",
            "cyclic_safe": True,
            "fields": {"voltage": {"at": 4, "type": "int24", "byte_order": "big", "scale": 0.001}},
        },
    },
}


ASK = 0


def framing(answer, options=ASKED, silence_ms=500.0, **changed):
    port = ScriptedPort(answer)
    one = BinaryFraming(
        Binary.model_validate({**options, **changed}),
        port,
        LineTime(TcpPort(host="device", port=1)),
        Silence(port.name, silence_ms),
    )
    return one, port


def board(delay=lambda: 0.0):
    """Answers each question with the number of the question: the strain is half of it, the temperature negative."""
    count = [0]

    def answer(data):
        count[0] += 1
        if data[3] == 0x11:
            return [(delay(), frame(0x91, struct.pack(">h", count[0])))]
        return [(delay(), frame(0x92, struct.pack("<Hb", count[0], -1)))]

    return answer


def perform(one, task, volts=0.0):
    inbox = Inbox()
    one.perform(task, [volts], inbox)
    return {one.inputs[sample.channel].name: sample.value for sample in inbox}


def begin(one):
    one.begin(time.monotonic_ns() + 300_000_000)


def test_a_late_answer_is_no_sample_and_answers_no_other_question():
    draw, delays, number = random.Random(2), [0.0], [0]
    device = board(lambda: draw.choice(delays))

    def numbered(data):
        number[0] += 1
        return device(data)

    one, _ = framing(numbered)
    begin(one)
    delays[:] = [0.0, 0.0, 0.003, 0.0045, 0.006, 0.009]
    good = late = 0
    end_s = time.monotonic() + 30.0
    while good <= 60 or late <= 20 or one.counters["late_answers"] <= 20:
        assert time.monotonic() < end_s, (good, late)
        time.sleep(0.0005)
        before = number[0]
        try:
            values = perform(one, ASK)
        except TransientError:
            late += 1
            continue
        if values:
            assert values == {"strain": 0.5 * number[0]}
            assert number[0] == before + 1
            good += 1


IDENTITY = {"request": "aa 55 00 01", "kind": 0x81, "numbers": {"number": {"at": 4, "type": "uint8", "value": 7}}}


def test_an_answer_that_comes_after_all_patience_is_still_not_taken_for_another():
    """Where the device can be asked who it is: it answers in order, so what comes before that answer is old."""
    device, late_s = board(), [0.0]

    def answer(data):
        if data[3] == 0x01:
            return [(0.0, frame(0x81, b"\x07"))]
        return [(late_s[0], said) for _, said in device(data)]

    one, _ = framing(answer, identity=IDENTITY)
    begin(one)
    late_s[0] = 0.05  # four times drain_ms
    with pytest.raises(TransientError):
        perform(one, ASK)
    late_s[0] = 0.0
    end_s = time.monotonic() + 1.0
    while not (values := perform(one, ASK)) and time.monotonic() < end_s:
        time.sleep(0.001)
    assert values == {"strain": 1.0}
    assert one.counters["late_answers"] == 1


@pytest.fixture
def stream():
    """The board that speaks by itself, in this process: what it says is put into `said`."""
    said = [frame(0x81, struct.pack("<I", 1234))]
    one, port = framing(lambda data: [(0.0, said[0])], FRAMING["binary"])
    begin(one)
    return one, port


def strains(count, status=0, x=0):
    return frame(0x10, struct.pack("<HB3i", count, status, x, 0, 0))


def test_what_nothing_answers_is_taken_when_the_device_is_heard_after_it(stream):
    one, port = stream
    port.answer = lambda data: []
    task = next(number for number, task in enumerate(one.tasks) if task.outputs)
    inbox = Inbox()
    for _ in range(3):
        assert one.perform(task, [0.0] * len(one.outputs), inbox) is Outcome.SENT
    one.receive(inbox, time.monotonic_ns())
    assert inbox.take_confirmed() == []  # a hole in both directions
    port.coming.append((time.monotonic_ns(), strains(1)))
    one.receive(inbox, time.monotonic_ns())
    assert inbox.take_confirmed() == [task]


def test_identity_must_be_told_twice():
    """One frame may be noise that looked like one."""
    said = [frame(0x81, struct.pack("<I", 99)), frame(0x81, struct.pack("<I", 1234))]
    one, _ = framing(lambda data: [(0.0, said.pop(0))], FRAMING["binary"])
    begin(one)
    one, _ = framing(lambda data: [(0.0, frame(0x81, struct.pack("<I", 99)))], FRAMING["binary"])
    with pytest.raises(IdentityMismatch, match="has serial_number 99, the configuration says 1234"):
        begin(one)


def test_bytes_without_frames_are_a_wrong_baud_rate():
    one, _ = framing(lambda data: [(0.0, bytes(range(1, 60)))], FRAMING["binary"])
    with pytest.raises(LinkError, match=r"sends \d+ bytes, and no frame is in them: are baud rate"):
        begin(one)


def test_echo_of_a_two_wire_line():
    """What is sent comes back before the answer does."""

    class Echoing(Board):
        def take(self, data):
            self.wire.write(data)
            super().take(data)

        def speak(self):
            pass

        def understand(self, unit):
            self.wire.write(frame(0x91, b"\x00\x08") if unit[3] == 0x11 else frame(0x92, b"\x01\x00\xff"))

    device = Echoing(PtyWire())
    device.start()
    patient = {**ASKED, "reply_ms": 250.0}
    options = {"serial": {**device.wire.options["serial"], "rs485": {"echo": True}}, "binary": patient}
    line = Line(Line.Options.model_validate(options), None)
    try:
        line.open()
        for _ in range(5):
            assert perform(line._framing, ASK) == {"strain": 4.0}
        assert line.statistics()["echo_errors"] == 0
        assert line.statistics()["skipped_bytes"] == 0
    finally:
        line.close()
        device.kill()
