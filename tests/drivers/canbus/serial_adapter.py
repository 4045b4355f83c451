"""CAN adapters on a pseudo terminal, each with a gauge behind it that counts its frames.

The frames are laid out by hand: identifier 0x101, a word with the strain, a byte with nothing, a byte with the count.
"""

import os
import pty
import select
import threading
import time
import tty

DBC = """VERSION ""
BU_: Gauge Host
BO_ 257 Gauge: 4 Gauge
 SG_ strain_x : 0|16@1+ (0.01,0) [0|100] "um" Host
 SG_ Count : 24|8@1+ (1,0) [0|255] "" Host
BO_ 256 Command: 4 Host
 SG_ voltage_x : 0|16@1+ (0.01,0) [0|100] "V" Gauge
 SG_ Count : 24|8@1+ (1,0) [0|255] "" Gauge
"""


def slcan(data):
    """A frame as the adapters of Lawicel, and all that follow them, have it."""
    return b"t1014" + data.hex().upper().encode() + b"\r"


def seeedstudio(data):
    """The same of the USB-CAN analyser."""
    return bytes((0xAA, 0xC0 | len(data), 0x01, 0x01)) + data + b"\x55"


class SerialAdapter:
    """Sends a frame as ``said(number, frame)`` has it: pieces, each with what to wait before it (s)."""

    def __init__(self, link, frame, rate_hz, said=lambda number, frame: [(0.0, frame)]):
        self.link, self.frame, self.rate_hz, self.said = link, frame, rate_hz, said
        self.sent = 0
        self.heard = b""
        self.reads = self.speaks = True
        self._ends = False
        self._master, self._slave = pty.openpty()
        tty.setraw(self._slave)
        link.symlink_to(os.ttyname(self._slave))
        self._thread = threading.Thread(target=self._serve)

    def __enter__(self):
        self._thread.start()
        return self

    def __exit__(self, *raised):
        self._ends = True
        self._thread.join()
        os.close(self._master)
        os.close(self._slave)

    def _serve(self):
        due = time.monotonic()
        while not self._ends:
            due = max(due, time.monotonic() - 1.0 / self.rate_hz)  # no burst after it was held up
            if select.select([self._master] if self.reads else [], [], [], max(0.0, min(0.02, due - time.monotonic())))[
                0
            ]:
                self.heard += os.read(self._master, 4096)
            if time.monotonic() < due:
                continue
            due += 1.0 / self.rate_hz
            if self.speaks and self.heard:
                self.sent += 1
                for wait_s, piece in self.said(self.sent, self.frame(bytes((0xD2, 4, 0, self.sent & 255)))):
                    time.sleep(wait_s)
                    os.write(self._master, piece)
