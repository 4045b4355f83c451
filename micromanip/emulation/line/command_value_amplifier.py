r"""An amplifier with commands such as "set,0,12.300": a word, a channel and a value, between commas, ended by \r.

set,<channel>,<volts>      not answered
<read>,<channel>           <read>,<channel>,<value>, where <read> is a command that the configuration reads with
<identity request>         who it is
anything else              err,<code>: 1 unknown command, 2 no such channel, 3 value, 4 out of range
"""

from __future__ import annotations

import math

from .device import Behind
from .device_line import DeviceLine
from .fault import LineFault
from .faults import Identity
from .gcs_axis import Affine

IDENTITY = "NV40/3CLE 0042 simulated"
WRONG_IDENTITY = "NV120/1 0043 simulated"
_UNKNOWN_COMMAND, _NO_CHANNEL, _BAD_VALUE, _OUT_OF_RANGE = 1, 2, 3, 4


class CommandValueAmplifier:
    """Channels are named by text, and read by one or several commands."""

    faults: tuple[type[LineFault], ...] = (Identity,)
    single_bytes = b""

    def __init__(
        self,
        writes: dict[tuple[str, str], tuple[Affine, tuple[float, float]]],
        reads: dict[tuple[str, str], Affine],
        identity_request: str,
        behind: Behind,
        line: DeviceLine,
    ) -> None:
        """`writes` and `reads` are by command and channel; an output has its limits, in numbers on the line."""
        self.signals = [behind.signal(read.channel) for read in reads.values() if behind.has(read.channel)]
        self.description = f"command,value amplifier, {len(writes)} channels"
        self._writes, self._reads, self._identity_request = writes, reads, identity_request
        self._behind, self._line = behind, line
        self._commands = {command for command, _ in [*writes, *reads]}

    def answer(self, line: str) -> str:
        if line.strip() == self._identity_request:
            return f"{WRONG_IDENTITY if self._line.active(Identity) else IDENTITY}\r\n"
        command, *rest = (part.strip() for part in line.split(","))
        if command not in self._commands:
            return _error(_UNKNOWN_COMMAND)
        channel = rest[0] if rest else ""
        if len(rest) == 2:
            return self._written(command, channel, rest[1])
        if (command, channel) in self._reads:
            number = self._number(self._reads[command, channel], channel)
            return f"{command},{channel},{number:.4f}\r\n"
        return _error(_NO_CHANNEL)

    def step(self) -> None:
        """It moves nothing by itself."""

    def reboot(self) -> None:
        """It keeps nothing."""

    def _written(self, command: str, channel: str, text: str) -> str:
        if (command, channel) not in self._writes:
            return _error(_NO_CHANNEL)
        output, (low, high) = self._writes[command, channel]
        try:
            number = float(text)
        except ValueError:
            return _error(_BAD_VALUE)
        if not math.isfinite(number):
            return _error(_BAD_VALUE)
        if not low <= number <= high:
            return _error(_OUT_OF_RANGE)
        self._behind.write({output.channel: output.value(number)})
        return ""

    def _number(self, read: Affine, channel: str) -> float:
        """What the sensor says; a channel without one tells its voltage, as a monitor does."""
        if self._behind.has(read.channel):
            return read.number(self._behind.read(read.channel))
        for (_, written), (output, _) in self._writes.items():
            if written == channel:
                return read.number(self._behind.voltage_V(output.channel))
        return 0.0


def _error(code: int) -> str:
    return f"err,{code}\r\n"
