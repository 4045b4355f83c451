"""Units of makers who read the standard in their own way: understood where that is safe, told in numbers elsewhere."""

import pytest
from micromanip_drivers.modbus.driver import Modbus

from micromanip.bus.beginning import opened
from micromanip.bus.errors import LinkError, TransientError
from micromanip.emulation.modbus.server import TcpFrames

from ..line.starting_device import StartingDevice
from .scripted import Scripted, options

pytestmark = pytest.mark.live  # answers around a time-out of some milliseconds

WRITE = {"set": {"function": 6, "rate_hz": 20, "write": {"v": {"address": 16, "type": "uint16", "cyclic_safe": True}}}}


def numbered(number):
    """Answers have this transaction number."""
    return lambda frame, request: [(0.0, number.to_bytes(2, "big") + frame[2:])]


def test_a_device_without_transaction_numbers_is_read():
    unit = Scripted(serial=False, manner=numbered(0))
    assert unit.turn() == [2.0]
    assert unit.turn() == [3.0]


def test_a_late_answer_without_a_number_is_taken_for_no_other():
    unit = Scripted(serial=False, manner=numbered(0))
    unit.unit.said[2] = lambda frame, request: [(0.025, b"\0\0" + frame[2:])]
    with pytest.raises(TransientError, match="no answer"):
        unit.turn(wait_ns=20_000_000)
    with pytest.raises(TransientError, match="transaction number 0"):
        unit.turn()
    found = unit.turn()
    assert found[-1] == unit.unit.requests, "each is the answer to its own request"


def test_another_transaction_number_is_told():
    with pytest.raises(LinkError, match=r"an answer came with transaction number 777 instead of \d"):
        Scripted(serial=False, manner=numbered(777))


@pytest.mark.parametrize(
    ("before", "behind"),
    [("00", ""), ("ff", ""), ("00 00 fe", ""), ("80", ""), ("", "00"), ("", "ff ff"), ("00", "00"), ("01", "")],
)
def test_noise_beside_a_good_answer_does_no_harm(before, behind):
    noisy = lambda frame, request: [(0.0, bytes.fromhex(before) + frame + bytes.fromhex(behind))]  # noqa: E731
    unit = Scripted(serial=True, manner=noisy)
    assert unit.turn() == [2.0]
    assert unit.turn() == [3.0]
    assert unit.driver.statistics()["stray_bytes"] >= 2 * len(bytes.fromhex(before + behind))


def test_noise_before_a_damaged_answer_makes_it_no_better():
    unit = Scripted(serial=True)
    unit.unit.said[2] = lambda frame, request: [(0.0, b"\0" + frame[:-1] + bytes([frame[-1] ^ 1]))]
    with pytest.raises(TransientError, match="checksum"):
        unit.turn()


@pytest.mark.parametrize("serial", [False, True])
def test_a_device_that_limits_what_is_written_is_told_of_once_and_in_numbers(serial):
    unit = Scripted(serial=serial, tasks=WRITE)
    limited = unit.unit.answer
    unit.unit.answer = lambda pdu: pdu[:3] + b"\x01\xf4" if pdu[0] == 6 else limited(pdu)
    said = []
    for value in (0.0, 3.0, 7.0):
        unit.turn([value])
        said += unit.inbox.remarks
        assert not unit.inbox.take_confirmed(), "it has another value than the one that was sent"
    assert [text.partition(": ")[2] for text in said] == [
        "register 16 was set to 500 instead of 0: does the device limit it?"
    ]
    unit.turn([500.0])
    assert unit.inbox.take_confirmed() == [0]


def test_a_late_answer_to_a_write_is_no_limit():
    unit = Scripted(serial=True, tasks=WRITE)
    unit.turn([4.0])
    first = unit.unit.requests
    unit.unit.said[first + 1] = lambda frame, request: []
    with pytest.raises(TransientError, match="no answer"):
        unit.turn([5.0])
    assert not unit.inbox.remarks


@pytest.mark.parametrize(("starts_s", "settle_ms"), [(1.5, 0.0), (0.3, 899.5)])
def test_a_connection_is_kept_while_the_device_starts(starts_s, settle_ms):
    frames = TcpFrames()

    def answer(data):
        return b"".join(
            request.seal(bytes((3, 2)) + b"\x00\x07" if request.pdu[0] == 3 else request.pdu[:5])
            for request in frames.taken(data, 0)
        )

    with StartingDevice(answer, starts_s) as device:
        keys = options(serial=False, timeout_ms=60)
        keys["tcp"] = {"host": "127.0.0.1", "port": device.port, "settle_ms": settle_ms}
        if settle_ms:  # all that is asked answers in time, and no part counts as missing
            keys["units"]["written"] = {**keys["units"]["u"], "unit_id": 2, "tasks": WRITE}
        driver = Modbus(Modbus.Options.model_validate(keys), None)
        assert opened(driver, lambda problem, for_s: for_s < 20.0)
        driver.close()
        assert device.connections == 1
