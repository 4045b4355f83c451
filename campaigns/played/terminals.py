"""An amplifier and a gauge on EtherCAT, at the far end of a veth pair; the controllers are those of the emulation."""

import os
import socket
import subprocess
import time
from pathlib import Path

import numpy as np

from micromanip.bus.ethercat.registers import ETHERTYPE
from micromanip.emulation.ethercat.line import Line
from micromanip.emulation.ethercat.terminal import INPUTS, OUTPUTS, Entry, Terminal

from . import amplifier as played
from .port import DatagramPort

_SCALE, _BAD = 1e-4, -(2**31)
_VENDOR = 0x4D4D


def _fields(index):
    return [Entry(index, subindex, 32) for subindex in (1, 2)]


_AMPLIFIER = Terminal("amplifier", _VENDOR, 0x1003, 1, 0, outputs={0x1600: _fields(0x7000)})
_GAUGE = Terminal("gauge", _VENDOR, 0x1004, 1, 0, inputs={0x1A00: _fields(0x6000)})


class Terminals:
    """They boot with the amplifier's power: INIT, until the master has brought them up."""

    def __init__(self, amplifier):
        self.amplifier, self.line, self._taken = amplifier, Line([_AMPLIFIER, _GAUGE]), 0

    def say(self):
        """Nothing by itself; their watchdogs go on."""
        self.line.tick(time.monotonic_ns())
        return ()

    def hear(self, frame):
        """A frame through both, and back."""
        fails = self.amplifier.fails
        codes = [_BAD if fails in ("nan", "exception") else round(um / _SCALE) for um in self.amplifier.strains_um()]
        self.line.applications[1].memory[INPUTS : INPUTS + 8] = np.array(codes, "<i4").view(np.uint8)
        back = self.line.passed(frame, time.monotonic_ns())
        taken = int(self.line.controllers[0]["outputs_count"])
        if taken != self._taken:
            self._taken = taken
            counts = self.line.applications[0].memory[OUTPUTS : OUTPUTS + 8].view("<i4")
            volts = {name: _SCALE * int(count) for name, count in zip(played.OUTPUTS, counts, strict=True)}
            self.amplifier.command(volts)
        if fails in ("empty", "garbage"):
            back = back[: len(back) // 2] if fails == "empty" else back[:14] + bytes(each ^ 0x55 for each in back[14:])
        if fails != "silent":
            yield played.LATE_S if fails == "late" else 0.0, frame if fails == "wrong unit" else back


class VethPort(DatagramPort):
    """The pair of interfaces, of which the controller opens the near one; takes the right to make it."""

    def _open(self):
        if not hasattr(self, "place"):
            self.place, far = (f"dev{os.getpid() % 10**6}{end}" for end in "nf")
            _ip("link", "add", self.place, "type", "veth", "peer", "name", far)
            for end in (self.place, far):
                Path(f"/proc/sys/net/ipv6/conf/{end}/disable_ipv6").write_text("1")
                _ip("link", "set", end, "up")
            self._socket = socket.socket(socket.AF_PACKET, socket.SOCK_RAW, socket.htons(ETHERTYPE))
            self._socket.bind((far, ETHERTYPE))
            self._socket.setblocking(False)
        self._link = self._conversation()

    def _close(self):
        if self._ending.is_set():
            self._socket.close()
            _ip("link", "del", self.place)

    def _break(self):
        """It has no connections."""

    def _rebooted(self):
        self._link = self._conversation()

    def _write(self, link, data):
        if link is self._link:
            self._socket.send(data)


def _ip(*arguments):
    subprocess.run(["ip", *arguments], check=True)
