"""The same for a serial line: a pseudo terminal in front of the device's own."""

import os
import select
import threading
import tty
from contextlib import suppress

import serial

from .wire import LOOK_S, READ_BYTES


class SerialWire:
    """A port `path` in front of the device's port `device`; cuts as of `Wire`, `reset` and `refused` unplug it."""

    def __init__(self, device, baud, path, make_tap):
        self.place = path
        self._back = serial.Serial(str(device), baud, timeout=0)
        self._make_tap = make_tap
        self._cut, self._late = None, b""
        self._lock = threading.RLock()
        self._front = None
        self._plug_in()
        self._ending = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def _plug_in(self):
        if self._front is None:
            self._front, self._slave = os.openpty()  # ours stays open: then nothing ends when the controller closes it
            tty.setraw(self._slave)
            os.set_blocking(self._front, False)
            self.place.symlink_to(os.ttyname(self._slave))
            self._tap = self._make_tap()

    def _unplug(self):
        if self._front is not None:
            self.place.unlink()
            os.close(self._slave)
            os.close(self._front)
            self._front = None

    def cut(self, how):
        """Cut it, one of `wire.CUTS`; it stays like this until `mend`."""
        with self._lock:
            self.mend()
            self._cut = how
            if how in ("reset", "refused"):
                self._unplug()
            if how == "reset":
                self._plug_in()

    def mend(self):
        """As before the cut; what was held back arrives."""
        with self._lock:
            self._cut = None
            self._plug_in()
            data, self._late = self._late, b""
            self._back.write(self._tap.to_device(data))

    def close(self):
        """End it."""
        self._ending.set()
        self._thread.join()
        with self._lock:
            self._unplug()
            self._back.close()

    def _run(self):
        while not self._ending.is_set():
            with self._lock:
                front = self._front
            ends = [self._back.fileno(), *([] if front is None else [front])]
            try:
                ready, _, _ = select.select(ends, [], [], LOOK_S)
            except (OSError, ValueError):
                continue  # it was unplugged meanwhile
            with self._lock, suppress(OSError):
                if self._back.fileno() in ready:
                    self._from_device(self._back.read(READ_BYTES))
                if self._front is not None and self._front == front and front in ready:
                    self._to_device(os.read(front, READ_BYTES))

    def _to_device(self, data):
        if self._cut == "late":
            self._late += data
        elif self._cut != "hole":
            self._back.write(self._tap.to_device(data))

    def _from_device(self, data):
        if self._front is not None and self._cut not in ("hole", "late", "deaf"):
            with suppress(BlockingIOError):  # nobody reads
                os.write(self._front, data)
