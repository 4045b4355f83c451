"""Devices that print their numbers, and what they have instead of them, in their own way."""

import math
import struct

import pytest
from micromanip_drivers.line.ascii_text import Lines, Reply
from micromanip_drivers.line.driver import Line

from micromanip.bus.beginning import opened
from micromanip.bus.errors import IdentityMismatch, LinkError, StillOpening, TransientError
from micromanip.bus.inbox import Inbox

from .board import FRAMING, frame
from .scripted_port import raised
from .starting_device import StartingDevice
from .test_conversation import begin, framing

pytestmark = pytest.mark.live  # replies around a time-out of some milliseconds


@pytest.mark.parametrize(
    ("template", "line", "value"),
    [
        ("{x} g", "   29.182 g", 29.182),
        ("{x} g", "-  29.182 g", -29.182),
        ("{x} g", "+  29.182  g", 29.182),
        ("{x} g", "-29.182g", -29.182),
        ("{x}g", "29.182 g", 29.182),
        ("MS,{x}", "MS,  -  1.5", -1.5),
        ("X {x} um", "X-12.5um", -12.5),
        ("{x}", "-   0.25", -0.25),
    ],
)
def test_numbers_in_fields_of_fixed_width(template, line, value):
    assert Reply(template).numbers(Lines().feed(line.encode() + b"\r\n")[0]) == {"x": value}


@pytest.mark.parametrize(
    ("template", "line"),
    [("CH1 {x}", "CH12.5"), ("{x} {y}", "12.5"), ("{x} g", "12 .5 g"), ("{x} g", "1 2 g"), ("{x} e5", "1e5")],
)
def test_blanks_make_no_number_out_of_another(template, line):
    assert Reply(template).numbers(line) is None


@pytest.mark.parametrize(
    "data", [b"\x13rk,0,1.5\r\x11", b"\x02rk,0,1.5\x03\r\n", b"rk,0\x13,1.5\x11\r", b"\x06rk,0,1.5\r\0"]
)
def test_control_characters_are_no_part_of_a_line(data):
    assert Lines().feed(data) == ["rk,0,1.5"]


@pytest.mark.parametrize(
    ("template", "line", "words"),
    [
        ("MS,{x}", "MS,-----", ()),
        ("MS,{x}", "MS,OVER", ()),
        ("MS,{x}", "MS,out of range", ()),
        ("A{y} B{x}", "A1.5 B---", ()),
        ("1={x}", "1=nan", ()),
        ("{x}", "-----", ()),
        ("{x}", "+INF", ()),
        ("{x} um", "****** um", ()),
        ("{x}", "no target", ("no target",)),
        ("{x}", "-1.#IND", ()),
        ("MS,{x} um", "MS,+999.999 um", ("+999.999",)),
    ],
)
def test_a_word_for_no_reading_is_a_reading_without_a_number(template, line, words):
    found = Reply(template, words).readings(line)
    assert found is not None
    assert math.isnan(found["x"])


@pytest.mark.parametrize(("template", "line"), [("{x}", "ERROR"), ("{x}", "no target"), ("MS,{x}", "MX,-----")])
def test_another_line_is_none(template, line):
    assert Reply(template).readings(line) is None


TEXT = {
    "terminator": "CRLF",
    "reply_ms": 4.0,
    "drain_ms": 12.0,
    "read": {"pos": {"request": "MS", "reply": ["MS,{strain}"], "rate_hz": 20, "fields": {"strain": {}}}},
    "write": {"volt": {"request": "SV,{voltage}", "rate_hz": 20, "cyclic_safe": True, "fields": {"voltage": {}}}},
}


def test_without_a_reading_the_samples_are_bad_and_the_link_lives():
    one, port = framing(lambda data: [(0.0, b"MS,-----\r\n")] if data == b"MS\r\n" else [], TEXT, silence_ms=10.0)
    begin(one)
    inbox = Inbox()
    for _ in range(20):
        one.perform(0, [0.0], inbox)
        one.perform(1, [3.0], inbox)
    assert len(inbox) == 20
    assert all(sample.status for sample in inbox)
    assert port.sent.count(b"SV,3.0000\r\n") == 20, "the voltages go on"


def test_what_came_and_was_not_understood_is_told_with_the_lost_link():
    one, _ = framing(lambda data: [(0.0, b"hello there\r\n")] if data == b"MS\r\n" else [], TEXT, silence_ms=10.0)
    begin(one)
    problem = raised(lambda: one.perform(0, [0.0], Inbox()), passing=TransientError)
    assert isinstance(problem, LinkError)
    assert '"hello there"' in str(problem)


def line(device, **port):
    return Line(
        Line.Options.model_validate(
            {
                "tcp": {"host": "127.0.0.1", "port": device.port, **port},
                "ascii": {"terminator": "LF", "identity": {"request": "ID", "pattern": "^AMP-3"}, "read": TEXT["read"]},
            }
        ),
        None,
    )


def answers(data):
    return b"AMP-3 of 2024\n" * data.count(b"ID\n")


def board(device):
    tcp = {"host": "127.0.0.1", "port": device.port}
    return Line(Line.Options.model_validate({"tcp": tcp, **FRAMING}), None)


def board_answers(data):
    return frame(0x81, struct.pack("<I", 1234)) * data.count(b"\xaa\x55\x00\x01")


@pytest.mark.parametrize(
    ("kind", "answer", "greeting"),
    [
        (line, answers, b""),
        (line, answers, b"boot 1.2\n"),
        (board, board_answers, b""),
        (board, board_answers, b"boot"),
    ],
)
def test_a_board_that_starts_with_its_port_is_given_time(kind, answer, greeting):
    with StartingDevice(answer, 1.6, greeting) as device:
        driver = kind(device)
        with pytest.raises(StillOpening):
            driver.open()
        assert opened(driver, lambda problem, for_s: for_s < 20.0)
        driver.close()
        assert device.connections == 1


def test_nothing_is_sent_in_the_pause_after_opening():
    heard = []

    def answer(data):
        heard.append(data)
        return answers(data)

    with StartingDevice(answer, 0.0) as device:
        driver = line(device, settle_ms=1200.0)
        with pytest.raises(StillOpening, match="settle_ms"):
            driver.open()
        assert not heard
        assert opened(driver, lambda problem, for_s: for_s < 20.0)
        driver.close()
        assert device.connections == 1


def test_another_device_is_told_at_once():
    with StartingDevice(lambda data: b"OTHER\n" * data.count(b"ID\n"), 0.0) as device:
        driver = line(device)
        with pytest.raises(IdentityMismatch, match="OTHER"):
            driver.open()
