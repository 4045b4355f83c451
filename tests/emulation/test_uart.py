"""Bytes heard at another rate than they were sent at."""

import pytest

from micromanip.emulation.line.pseudo_terminal import as_heard


def test_at_the_same_rate_nothing_changes():
    assert as_heard(bytes(range(256)), 115200, 115200) == bytes(range(256))


def test_a_small_difference_of_rates_is_forgiven():
    """Up to half a bit over ten: 5 %."""
    data = bytes(range(1, 255))
    assert as_heard(data, 115200, 112000) == data
    assert as_heard(data, 112000, 115200) == data


def test_a_third_of_the_rate_by_hand():
    """Line, in bits of the sender after the edge: start 0-1, ones 1-5, zeros 5-9, stop 9-10, then idle.

    The receiver samples in the middle of its own bits, at 4.5 (one), 7.5 (zero), 10.5 (idle) and so on.
    """
    assert as_heard(b"\x0f", 300, 100) == bytes([0b1111_1101])


@pytest.mark.parametrize("heard_baud", [1200, 9600, 57600, 230400, 921600])
def test_at_a_wrong_rate_a_text_is_noise(heard_baud):
    text = b"(c)2015 Physik Instrumente (PI)\n"
    heard = as_heard(text, 115200, heard_baud)
    assert heard
    assert not set(text) >= set(heard)
    assert text not in heard


def test_twice_the_rate_hears_more_bytes():
    assert len(as_heard(b"\x55" * 10, 9600, 19200)) > 10
    assert as_heard(b"", 9600, 19200) == b""
