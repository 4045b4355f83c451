"""A tap hears each value, and what became of it, however the bytes are cut up; only what is whole goes on."""

import math
import struct

import pytest
from fastcrc import crc16

from campaigns.taps import Arrivals, BoardTap, GcsTap, ModbusTap


def pieces(data, length):
    return [data[k : k + length] for k in range(0, len(data), length)]


def test_the_gcs_tap_hears_each_value_and_what_became_of_it():
    arrivals = Arrivals()
    tap = GcsTap(arrivals, {"1": "x", "2": "y"})
    assert tap.to_device(b"POS? 1 2\nSVA 1 3.5") == b"POS? 1 2\n"
    assert tap.to_device(b"000 2 -1\nERR?\nSVA 1 200\n") == b"SVA 1 3.5000 2 -1\nERR?\nSVA 1 200\n"
    tap.to_device(b"ERR?\nSVA 1 nan\n")
    tap.from_device(b"1=2.0 \n2=7\n0\n1")
    tap.from_device(b"7\n")
    first, second, third, fourth = arrivals.copy()
    assert [(each.name, each.volts) for each in (first, second, third)] == [("x", 3.5), ("y", -1.0), ("x", 200.0)]
    assert math.isnan(fourth.volts)
    assert [each.refused for each in (first, second, third, fourth)] == [False, False, True, False]
    assert [each.taken_ns is None for each in (first, second, third, fourth)] == [False, False, False, True]
    assert arrivals.volts()["y"] == -1.0


def modbus(number, pdu):
    return struct.pack(">HHHB", number, 0, len(pdu) + 1, 1) + pdu


WRITES = (
    modbus(1, struct.pack(">BHh", 6, 100, -200)),
    modbus(2, struct.pack(">BHHBhh", 16, 100, 2, 4, 300, 400)),
    modbus(3, struct.pack(">BHHHHBhh", 23, 0, 4, 100, 2, 4, 500, 32767)),
    modbus(4, struct.pack(">BHH", 3, 100, 2)),
)


@pytest.mark.parametrize("length", [1, 7, 1000])
def test_modbus(length):
    arrivals = Arrivals()
    tap = ModbusTap(arrivals, {100: ("x", 0.005), 101: ("y", 0.005)})
    assert b"".join(tap.to_device(piece) for piece in pieces(b"".join(WRITES), length)) == b"".join(WRITES)
    for piece in pieces(modbus(2, struct.pack(">BHH", 16, 100, 2)) + modbus(3, b"\x97\x06"), length):
        tap.from_device(piece)
    given = [(each.name, round(each.volts, 6), each.taken_ns is not None, each.refused) for each in arrivals.copy()]
    assert given == [
        ("x", -1.0, False, False),
        ("x", 1.5, True, False),
        ("y", 2.0, True, False),
        ("x", 2.5, True, True),
        ("y", 163.835, True, True),
    ]


def board(kind, payload):
    body = bytes((len(payload), kind)) + payload
    return b"\xaa\x55" + body + crc16.ibm_3740(body).to_bytes(2, "big")


@pytest.mark.parametrize("length", [1, 5, 1000])
def test_board(length):
    arrivals = Arrivals()
    tap = BoardTap(arrivals, {6: ("x", 0.005), 8: ("y", 0.005)})
    whole = board(0x20, struct.pack("<Hhh", 1, 200, -200))
    stream = whole[:5] + whole + b"\xaa" + board(0x00, b"") + whole
    assert b"".join(tap.to_device(piece) for piece in pieces(stream, length)) == stream
    assert [(each.name, each.volts) for each in arrivals.copy()] == [("x", 1.0), ("y", -1.0)] * 2
