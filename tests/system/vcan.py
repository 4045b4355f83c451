"""vcan0 of the virtual machine, and the programs of can-utils on it."""

import re
import subprocess
from pathlib import Path

from host.cell import until

from .machine import ok

CHANNEL = "vcan0"
_FLAGS = re.compile("(?<=##).")
_ALL_FRAMES = Path("/proc/net/can/rcvlist_all")


def set_link(*arguments, channel=CHANNEL):
    ok("ip", "link", "set", channel, *arguments)


def listeners():
    """How many sockets take every frame of vcan0."""
    return len(re.findall(rf"^\s+{CHANNEL} ", _ALL_FRAMES.read_text(), re.MULTILINE))


class Dump:
    """``candump`` until it has seen `count` frames."""

    def __init__(self, count):
        before = listeners()
        self._process = subprocess.Popen(
            ["candump", "-L", "-n", str(count), CHANNEL], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
        )
        until(lambda: listeners() > before, "candump", 60.0)

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self._process.kill()
        self._process.communicate()

    def frames(self):
        """What it saw, as `cansend` takes it."""
        out, err = self._process.communicate(timeout=120.0)
        assert self._process.returncode == 0, err
        return [_FLAGS.sub(_without_kernel_flag, line.split(" ")[2]) for line in out.splitlines()]


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
