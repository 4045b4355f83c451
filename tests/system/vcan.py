"""vcan0 of the virtual machine, and the programs of can-utils on it."""

import re
import signal
import subprocess
import tempfile
from pathlib import Path

from campaigns.running_controller import until

from .machine import ok

CHANNEL = "vcan0"
_FLAGS = re.compile("(?<=##).")
_ALL_FRAMES = Path("/proc/net/can/rcvlist_all")
_AND_ERROR_FRAMES = ",0:0,#FFFFFFFF"


def set_link(*arguments, channel=CHANNEL):
    ok("ip", "link", "set", channel, *arguments)


def listeners():
    """How many sockets take every frame of vcan0."""
    return len(re.findall(rf"^\s+{CHANNEL} ", _ALL_FRAMES.read_text(), re.MULTILINE))


class Dump:
    """``candump`` until it has seen `count` frames, or until `end`."""

    def __init__(self, count=None, errors=False):
        before = listeners()
        until_count = ["-n", str(count)] if count else []
        filters = _AND_ERROR_FRAMES if errors else ""
        self._out = tempfile.TemporaryFile("w+")  # a pipe would be full one day  # noqa: SIM115
        self._process = subprocess.Popen(
            ["candump", "-L", *until_count, CHANNEL + filters], stdout=self._out, stderr=subprocess.PIPE, text=True
        )
        until(lambda: listeners() > before, "candump", 60.0)

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self._process.kill()
        self._process.communicate()
        self._out.close()

    def end(self):
        """Ctrl-C, which it takes as its orderly end."""
        self._process.send_signal(signal.SIGINT)

    def lines(self):
        """Time of reception (wall clock, ns) of each frame that it saw, and the frame as `cansend` takes it."""
        _, err = self._process.communicate(timeout=120.0)
        assert self._process.returncode == 0, err
        self._out.seek(0)
        rows = [line.split() for line in self._out]
        return [(_ns(stamp), _FLAGS.sub(_without_kernel_flag, frame)) for stamp, _, frame in rows]

    def frames(self):
        """What it saw, as `cansend` takes it."""
        return [frame for _, frame in self.lines()]


def _ns(stamp):
    """Of "(1700000000.123456)"."""
    seconds, microseconds = stamp.strip("()").split(".")
    return int(seconds) * 1_000_000_000 + int(microseconds) * 1000


def _without_kernel_flag(flags):
    """Newer kernels mark CAN FD frames with a third flag (CANFD_FDF)."""
    return f"{int(flags[0], 16) & 3:X}"


def written(message):
    """A frame of python-can as can-utils write it."""
    identifier = f"{message.arbitration_id:08X}" if message.is_extended_id else f"{message.arbitration_id:03X}"
    if message.is_remote_frame:
        return f"{identifier}#R{message.dlc or ''}"
    data = message.data.hex().upper()
    if message.is_fd:
        return f"{identifier}##{message.bitrate_switch + 2 * message.error_state_indicator:X}{data}"
    return f"{identifier}#{data}"


def error_frame(kind, state=0):
    """An error frame as `cansend` takes it: its class (linux/can/error.h), and what the controller says of itself."""
    return f"{0x20000000 | kind:08X}#00{state:02X}000000000000"
