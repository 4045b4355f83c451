"""A serial line: pyserial sets it up, reading and writing are the kernel's own calls.

pyserial's ``read`` returns short after a time-out and selects before every byte; its ``write`` waits. Only its setting
up of the terminal and of low latency is used.
"""

from __future__ import annotations

import contextlib
import errno
import os
import termios
import time
from pathlib import Path

import serial

from .options import SerialPort
from .port import Port

_PARITIES = {"none": serial.PARITY_NONE, "even": serial.PARITY_EVEN, "odd": serial.PARITY_ODD}


class SerialLine(Port):
    """The line that `options` name."""

    largest = 4096
    waiting_request = termios.TIOCOUTQ

    def __init__(self, options: SerialPort) -> None:
        super().__init__(options.device)
        self._options, self.settle_ns = options, round(options.settle_ms * 1e6)
        self._serial: serial.Serial | None = None
        rs485 = options.rs485
        self._turnaround_ns = round(rs485.turnaround_us * 1e3) if rs485 else 0
        self._echo = Echo() if rs485 and rs485.echo else None
        self._quiet_ns = 0
        self.low_latency = False
        """True if the kernel hands over bytes at once, as far as it says."""
        if self._echo is not None:
            self.counters["echo_errors"] = 0

    @property
    def is_plain(self) -> bool:
        return self._options.rs485 is None

    def send(self, data: bytes) -> None:
        wait_ns = self._quiet_ns + self._turnaround_ns - time.monotonic_ns()
        if self._turnaround_ns and wait_ns > 0:
            time.sleep(wait_ns * 1e-9)
        super().send(data)
        if self._echo is not None:
            self._echo.sent(data)

    def _connect(self, deadline_ns: int) -> int:  # noqa: ARG002 (a line is there at once, or not)
        options = self._options
        if not Path(options.device).exists():
            raise OSError(errno.ENOENT, no_such_device())
        try:
            line = serial.Serial(
                options.device,
                options.baud,
                bytesize=options.bytesize,
                parity=_PARITIES[options.parity],
                stopbits=options.stopbits,
                timeout=0,
                write_timeout=0,
                exclusive=True,
            )
        except ValueError as problem:  # a rate that the port can't be set to
            raise OSError(errno.EINVAL, f"{problem}; is the baud rate {options.baud} right?") from problem
        except termios.error as problem:
            raise OSError(errno.EIO, f"it can't be set up ({problem.args[-1]}); is it a serial port?") from problem
        self._serial = line
        if options.low_latency:
            self._ask_for_low_latency(line)
        line.reset_input_buffer()
        if self._echo is not None:
            self._echo.clear()
        descriptor: int = line.fileno()
        _let_empty_mean_gone(descriptor)
        return descriptor

    def _disconnect(self) -> None:
        line, self._serial = self._serial, None
        if line is not None:
            with contextlib.suppress(OSError, termios.error):
                line.close()

    def _read(self, descriptor: int) -> tuple[bytes, int] | None:
        data = os.read(descriptor, self.largest)
        if not data:  # readable, with nothing to read: hung up
            raise OSError(errno.EIO, "it was unplugged, or its other end closed")
        now_ns = time.monotonic_ns()
        self._quiet_ns = now_ns
        return data, now_ns

    def _write(self, descriptor: int, data: bytes) -> int:
        return os.write(descriptor, data)

    def _cleaned(self, chunks: list[tuple[bytes, int]]) -> list[tuple[bytes, int]]:
        if self._echo is None:
            return chunks
        cleaned = [(self._echo.without(data), time_ns) for data, time_ns in chunks]
        self.counters["echo_errors"] = self._echo.errors
        return [(data, time_ns) for data, time_ns in cleaned if data]

    def _ask_for_low_latency(self, line: serial.Serial) -> None:
        try:
            line.set_low_latency_mode(True)
            self.low_latency = True
        except (OSError, ValueError, NotImplementedError):  # a pseudo terminal, an adapter whose driver does without
            self.low_latency = False


def _let_empty_mean_gone(descriptor: int) -> None:
    """As set up by pyserial, the kernel returns nothing both where nothing came and where the port went away."""
    attributes = termios.tcgetattr(descriptor)
    attributes[6][termios.VMIN], attributes[6][termios.VTIME] = 1, 0
    termios.tcsetattr(descriptor, termios.TCSANOW, attributes)


def no_such_device() -> str:
    """What to say where a port is not there."""
    folder = Path("/dev/serial/by-id")
    named = sorted(str(path) for path in folder.iterdir()) if folder.is_dir() else []
    others = sorted(str(path) for kind in ("ttyUSB*", "ttyACM*") for path in Path("/dev").glob(kind))
    return f"there is no such device; serial ports here: {', '.join(named or others) or 'none with a USB adapter'}"


class Echo:
    """Bytes that have been sent and must come back before anything else does.

    A byte that comes back as another one, or not at all, ends the comparison: what follows is taken as the device's,
    and its checksum or its layout decide.
    """

    def __init__(self) -> None:
        self._expected = b""
        self.errors = 0

    def clear(self) -> None:
        """Expect nothing."""
        self._expected = b""

    def sent(self, data: bytes) -> None:
        """So much was sent: it will come back. What has not come back of what was sent before never will."""
        self.errors += bool(self._expected)
        self._expected = data

    def without(self, data: bytes) -> bytes:
        """What of `data`, received next, is the device's own."""
        length = min(len(self._expected), len(data))
        if not length:
            return data
        if data[:length] == self._expected[:length]:
            self._expected = self._expected[length:]
            return data[length:]
        self.errors += 1
        self._expected = b""
        return data
