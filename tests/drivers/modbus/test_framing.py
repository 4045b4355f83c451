"""Answers found in what came: whole, in pieces, damaged, another's."""

import pytest
from micromanip_drivers.modbus.framing import BadFrame, DamagedFrame, RtuFraming, TcpFraming
from pymodbus.framer import FramerRTU, FramerSocket
from pymodbus.pdu import DecodePDU
from pymodbus.pdu.register_message import ReadHoldingRegistersRequest

HEAD, LENGTH = bytes.fromhex("03 04"), 6
ANSWER = bytes.fromhex("03 04 000a 0102")


def rtu(text):
    framing = RtuFraming()
    return framing.seal(0x11, bytes.fromhex(text))


def test_requests_are_those_of_the_library():
    request = ReadHoldingRegistersRequest(address=107, count=3, dev_id=0x11, transaction_id=1)
    pdu = bytes((3,)) + request.encode()
    assert RtuFraming().seal(0x11, pdu) == FramerRTU(DecodePDU(False)).buildFrame(request)
    assert TcpFraming().seal(0x11, pdu) == FramerSocket(DecodePDU(False)).buildFrame(request)


@pytest.mark.parametrize("framing", [TcpFraming, RtuFraming])
def test_an_answer_in_pieces_is_complete_with_its_last_byte(framing):
    framing = framing()
    framing.seal(0x11, b"\x03")
    frame = rtu(ANSWER.hex()) if isinstance(framing, RtuFraming) else bytes.fromhex("0001 0000 0007 11") + ANSWER
    buffer = bytearray()
    for byte in frame[:-1]:
        buffer.append(byte)
        assert framing.take(buffer, 0x11, HEAD, LENGTH) is None
    buffer.append(frame[-1])
    assert framing.take(buffer, 0x11, HEAD, LENGTH) == ANSWER
    assert not buffer


def test_answers_to_other_requests_are_dropped_and_counted():
    framing = TcpFraming()
    for _ in range(3):
        framing.seal(0x11, b"\x03")
    late, own = (bytes.fromhex(f"000{i} 0000 0007 11 03 04 000a 010{i}") for i in (2, 3))
    buffer = bytearray(late + late + own)
    assert framing.take(buffer, 0x11, HEAD, LENGTH) == bytes.fromhex("03 04 000a 0103")
    assert framing.late == 2


@pytest.mark.parametrize(
    ("frame", "why"),
    [
        ("0001 0001 0007 11 0304000a0102", "header"),
        ("0001 0000 0007 12 0304000a0102", "unit 18"),
        ("0001 0000 0007 11 0404000a0102", "begins with 04 04"),
        ("0001 0000 0006 11 0304000a01", "5 bytes instead of 6"),
        ("0001 0000 0004 11 830202", "begins with 83 02"),
    ],
)
def test_what_is_no_answer_over_tcp(frame, why):
    framing = TcpFraming()
    framing.seal(0x11, b"\x03")
    with pytest.raises(BadFrame, match=why) as raised:
        framing.take(bytearray.fromhex(frame), 0x11, HEAD, LENGTH)
    assert isinstance(raised.value, DamagedFrame) == (why != "header"), "by its number nothing more is under way"


@pytest.mark.parametrize("text", ["0304000a0102", "8302"])
def test_one_wrong_bit_is_found_on_a_serial_line(text):
    frame = rtu(text)
    for bit in range(8 * len(frame)):
        wrong = bytearray(frame)
        wrong[bit // 8] ^= 1 << bit % 8
        try:
            assert RtuFraming().take(wrong, 0x11, HEAD, LENGTH) is None, "at most it waits for more"
        except BadFrame:
            continue
