"""The rate of a serial port as a number: any rate, not only those that have a name."""

from __future__ import annotations

import fcntl
import struct
import termios

from micromanip.errors import DeviceUnavailable

_TERMIOS2 = struct.Struct("=4IB19s2I")
_TCGETS2, _TCSETS2 = 0x802C542A, 0x402C542B
_CBAUD, _BOTHER = 0o010017, 0o010000


def baud_of(fileno: int) -> int:
    """The rate that the port was set to by who opened it: both ends of a pseudo terminal show it."""
    try:
        return int(_TERMIOS2.unpack(fcntl.ioctl(fileno, _TCGETS2, bytes(_TERMIOS2.size)))[-1])
    except OSError as error:
        raise DeviceUnavailable(f"the rate of a pseudo terminal can't be read: {error.strerror}") from error


def set_baud(fileno: int, baud: int) -> None:
    """Set both directions, and one stop bit."""
    settings = list(_TERMIOS2.unpack(fcntl.ioctl(fileno, _TCGETS2, bytes(_TERMIOS2.size))))
    settings[2] = (settings[2] & ~(_CBAUD | _CBAUD << 16) & ~termios.CSTOPB) | _BOTHER
    settings[-2:] = [baud, baud]
    fcntl.ioctl(fileno, _TCSETS2, _TERMIOS2.pack(*settings))
