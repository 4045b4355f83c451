"""Requests and replies by lines of text: in order, or not at all."""

import random
import time

import pytest
from micromanip_drivers.line.ascii import AsciiFraming
from micromanip_drivers.line.ascii_options import Ascii
from micromanip_drivers.line.framing import LineTime, Silence
from micromanip_drivers.line.options import TcpPort

from micromanip.bus.errors import DeviceFault, LinkError, TransientError
from micromanip.bus.inbox import Inbox

from .gcs_controller import IDN
from .scripted_port import ScriptedPort, raised

pytestmark = pytest.mark.live  # replies around a time-out of some milliseconds

GCS = {
    "preset": "gcs",
    "reply_ms": 4.0,
    "drain_ms": 12.0,
    "read": {
        "position": {"command": "POS?", "rate_hz": 100, "fields": {"strain": {"item": "1"}}},
        "voltage": {"command": "VOL?", "rate_hz": 100, "fields": {"monitor": {"item": "1"}}},
    },
    "write": {"command": {"command": "SVA", "rate_hz": 100, "cyclic_safe": True, "fields": {"voltage": {"item": "1"}}}},
}
POSITION, VOLTAGE, COMMAND = 0, 1, 2


def gcs_device(delay=lambda: 0.0, error="0", idn=IDN):
    """POS? is 1000 and more, VOL? is below: a value tells which question it answers."""
    count = [0]

    def answer(data):
        replies = []
        for line in data.decode().split("\n")[:-1]:
            count[0] += 1
            said = {"*IDN?": idn, "ERR?": error, "POS? 1": f"1={1000 + count[0]}", "VOL? 1": f"1={-count[0]}"}.get(line)
            if said is not None:
                replies.append((delay(), f"{said}\n".encode()))
        return replies

    return answer


def framing(answer, options=GCS, silence_ms=500.0, **changed):
    port = ScriptedPort(answer)
    one = AsciiFraming(
        Ascii.model_validate({**options, **changed}),
        port,
        LineTime(TcpPort(host="device", port=1)),
        Silence(port.name, silence_ms),
    )
    return one, port


def begin(one):
    one.begin(time.monotonic_ns() + 400_000_000)
    return one


def read(one, task):
    inbox = Inbox()
    one.perform(task, [0.0], inbox)
    return [sample.value for sample in inbox]


@pytest.mark.parametrize("identity", [None, "Physik"])
def test_a_late_reply_is_never_taken_for_that_of_another_question(identity):
    """With delays around the time-out, in any order; and good replies still come."""
    draw = random.Random(4)
    delays = [0.0]
    one, _ = framing(gcs_device(lambda: draw.choice(delays)), identity=identity, silence_ms=60_000.0)
    begin(one)
    delays[:] = [0.0, 0.0, 0.0, 0.003, 0.0045, 0.006, 0.009]
    good = late = 0
    end_s = time.monotonic() + 1.2
    while time.monotonic() < end_s:
        time.sleep(0.0005)
        task = draw.choice((POSITION, VOLTAGE, COMMAND))
        try:
            values = read(one, task)
        except TransientError:
            late += 1
            continue
        good += len(values)
        for value in values:
            assert value > 1000 if task == POSITION else value < 0
    assert good > 20
    assert late > 5
    assert one.counters["late_lines"] > 5


def test_a_missing_reply_is_one_error_and_the_next_question_waits():
    lost = [False]
    device = gcs_device()
    one, port = framing(lambda data: [] if lost[0] else device(data), identity="Physik")
    begin(one)
    lost[0] = True
    with pytest.raises(TransientError, match=r"no reply to POS\? 1 within 4 ms"):
        read(one, POSITION)
    assert read(one, VOLTAGE) == []
    assert b"VOL? 1\n" not in port.sent
    lost[0] = False
    end_s = time.monotonic() + 1.0
    while not (values := read(one, VOLTAGE)) and time.monotonic() < end_s:
        time.sleep(0.001)
    assert values[0] < 0
    assert one.counters["missing_replies"] == 1
    assert one.counters["held_back"] >= 1


@pytest.mark.parametrize("reply", ["1=", "1=1,5", "1=0x10", "1=1 2", "11=1", "1=1=1"])
def test_what_is_no_number_is_no_value(reply):
    one, _ = framing(lambda data: [(0.0, b"0\n" if b"ERR?" in data else reply.encode() + b"\n")])
    begin(one)
    with pytest.raises(TransientError):
        read(one, POSITION)


def test_gcs_error_is_a_fault_of_the_device():
    codes = ["0", "7"]
    device = gcs_device()
    one, port = framing(lambda data: [(0.0, codes.pop(0).encode() + b"\n")] if b"ERR?" in data else device(data))
    begin(one)
    with pytest.raises(DeviceFault, match=r"error 7 \(position out of limits\) after SVA 1"):
        one.perform(COMMAND, [12.3], Inbox())
    assert port.sent[-1] == b"SVA 1 12.3000\nERR?\n"


def test_after_a_missing_reply_the_controller_says_why():
    """A controller does not answer a question that it doesn't know, and keeps the reason for ERR?."""
    errors = ["0", "2"]

    def answer(data):
        known = {b"*IDN?\n": IDN, b"ERR?\n": errors[0] if len(errors) == 1 else errors.pop(0)}
        return [(0.0, f"{known[data]}\n".encode())] if data in known else []

    one, _ = framing(answer, identity="Physik")
    begin(one)
    with pytest.raises(TransientError):
        read(one, POSITION)
    problem = raised(lambda: read(one, POSITION))
    assert isinstance(problem, DeviceFault)
    assert "error 2 (unknown command)" in str(problem)


def test_error_of_before_is_forgotten_at_the_beginning():
    codes = ["5", "0"]
    one, _ = framing(lambda data: [(0.0, f"{codes.pop(0)}\n".encode())])
    begin(one)
    one.perform(COMMAND, [1.0], Inbox())
    assert not codes


COMMAND_VALUE = {
    "preset": "command,value",
    "read": {
        "monitor": {"command": "rk", "rate_hz": 50, "fields": {"x": {"item": "0", "scale": 2.0}, "y": {"item": "1"}}}
    },
    "write": {
        "voltages": {
            "command": "set",
            "rate_hz": 50,
            "cyclic_safe": True,
            "fields": {"voltage": {"range": [-20, 150], "decimals": 3}},
        }
    },
}


def test_command_and_value():
    replies = {b"rk,0\r": b"rk,0,12.300\r\n", b"rk,1\r": b"rk,1,-4\r\n"}
    one, port = framing(lambda data: [(0.0, replies[data])] if data in replies else [], COMMAND_VALUE)
    begin(one)
    assert read(one, 0) == [24.6, -4.0]
    one.perform(1, [12.3], Inbox())
    assert port.sent == [b"rk,0\r", b"rk,1\r", b"set,12.300\r"]


def test_templates():
    options = {
        "terminator": "CRLF",
        "identity": {"request": "ID", "pattern": "^AMP-3 "},
        "errors": {"request": "STAT", "reply": "STAT {code}"},
        "start": ["REMOTE"],
        "read": {
            "gauges": {
                "request": "MEAS ALL",
                "reply": ["X {x} um", "Y {y} um"],
                "rate_hz": 100,
                "fields": {"x": {"offset": 1.0}, "y": {}},
            }
        },
        "write": {
            "out": {"request": "OUT {v}%", "reply": ["OK"], "rate_hz": 100, "cyclic_safe": True, "fields": {"v": {}}}
        },
    }
    replies = {
        b"ID\r\n": b"AMP-3 v2\r\n",
        b"STAT\r\n": b"STAT 0\r\n",
        b"REMOTE\r\nSTAT\r\n": b"STAT 0\r\n",
        b"MEAS ALL\r\n": b"X  1.5 um\r\nY -2e1 um\r\n",
        b"OUT 2.5000%\r\nSTAT\r\n": b"OK\r\nSTAT 0\r\n",
    }
    one, port = framing(lambda data: [(0.0, replies[data])], options)
    begin(one)
    assert read(one, 0) == [2.5, -20.0]
    one.perform(1, [2.5], Inbox())
    assert set(port.sent) == set(replies)


def test_an_old_line_is_not_taken_for_the_identity():
    """A serial port may still hold what was said to the program before."""
    device, old = gcs_device(), [(0.0, b"1=12.5\n")]
    one, _ = framing(lambda data: [*(old and [old.pop()]), *device(data)], identity="Physik")
    begin(one)


def test_a_question_of_before_is_no_silence_on_a_port_that_was_opened_anew():
    """The first turns after it may be writes that nothing answers."""
    amplifier = {
        "preset": "command,value",
        "reply_ms": 4.0,
        "read": {"position": {"command": "meas", "rate_hz": 100, "fields": {"strain": {}}}},
        "write": {"v": {"command": "set", "rate_hz": 100, "cyclic_safe": True, "fields": {"voltage": {}}}},
    }
    one, _ = framing(lambda data: [], options=amplifier, silence_ms=20.0)
    assert isinstance(raised(lambda: one.perform(0, (0.0,), Inbox()), passing=TransientError), LinkError)
    one.begin(time.monotonic_ns() + 1_000_000_000)
    assert one.perform(1, (0.0,), Inbox()) is None
    one.receive(Inbox(), 0)


def test_silence_counts_from_the_first_question_that_was_not_answered():
    device, dead = gcs_device(), []
    one, _ = framing(lambda data: [] if dead else device(data), silence_ms=60.0)
    begin(one)
    time.sleep(0.1)
    one.receive(Inbox(), 0)  # nothing was asked
    dead.append(True)
    begin_s = time.monotonic()
    problem = raised(lambda: read(one, POSITION), passing=TransientError)
    assert isinstance(problem, LinkError)
    assert "nothing understood for 60 ms" in str(problem)
    assert time.monotonic() - begin_s >= 0.06


def test_noise_before_a_reply_does_not_become_a_part_of_it():
    options = {
        "terminator": "LF",
        "read": {"value": {"request": "X?", "reply": ["{x}"], "rate_hz": 100, "fields": {"x": {}}}},
    }
    one, port = framing(lambda data: [(0.0, b"5\n")], options)
    begin(one)
    port.coming.append((time.monotonic_ns(), b"1"))
    assert read(one, 0) == [5.0]
