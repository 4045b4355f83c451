"""Where a device is opened: a TCP or UDP port, or a terminal; a thread serves it, and its line can be cut."""

import ctypes
import heapq
import os
import select
import socket
import struct
import threading
import time
import tty
from contextlib import suppress

from .amplifier import HeldBack

CUTS = ("reset", "refused", "hole", "late", "deaf")
"""reset: connections break, new ones are accepted. refused: as long as the cut lasts, there is no port either.
hole: connections stand, nothing goes either way, and what was sent is lost. late: the same, but what was sent to the
device arrives when the cut is mended, as TCP would have it, unless it was held back for too long (`Habits`). deaf:
commands arrive, answers don't."""
LOOK_S, _STALL_S = 0.002, 0.02
_READ_BYTES = 65536
_RESET = struct.pack("=ii", 1, 0)
_IN_OPEN = 0x20


class Port:
    """Serves one device. `converse()` makes who hears a connection: ``hear(data)`` gives answers, (late by s, bytes).

    ``say()`` gives what the device sends by itself. A subclass opens, closes, reads and writes.
    """

    def __init__(self, amplifier, converse):
        self.amplifier, self._converse = amplifier, converse
        self._cut, self._held = None, HeldBack(amplifier)
        self._outbox = []
        self._boots, self._number = amplifier.boots, 0
        self.frozen = threading.Lock()
        self.lock = threading.RLock()
        self._ending = threading.Event()
        self._open()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def cut(self, how):
        """Cut it, one of `CUTS`; it stays like this until `mend`."""
        with self.lock:
            self.mend()
            self._cut = how
            if how in ("reset", "refused"):
                self._break()
            if how == "refused":
                self._close()

    @property
    def is_cut(self):
        return self._cut is not None

    def mend(self):
        """As before the cut; what was held back arrives."""
        with self.lock:
            was, self._cut = self._cut, None
            if was == "refused":
                self._open()
            for link, data in self._held.arriving():
                self._hear(link, data)

    def close(self):
        """End it."""
        self._ending.set()
        self._thread.join()
        with self.lock:
            self._break()
            self._close()

    def _run(self):
        ended_s = time.monotonic()
        while not self._ending.is_set():
            with self.lock:
                ends = self._ends()
            with suppress(OSError, ValueError):
                select.select(ends, [], [], LOOK_S)
            began_s = time.monotonic()
            stalled = began_s - ended_s > LOOK_S + _STALL_S
            with self.frozen:
                stood_s = time.monotonic() - began_s
                with self.lock, self.amplifier.lock:
                    self._turn(stood_s, stalled)
            ended_s = time.monotonic()

    def _turn(self, stood_s, stalled):
        """What came while the device stood still counts as held back; while this process did, as come in time."""
        if stalled and self._cut is None and select.select(self._ends(), [], [], 0.0)[0]:
            self.amplifier.feed()
        self.amplifier.look()
        if stood_s > self.amplifier.habits.longest_under_way_s and self._cut != "refused":
            for _ in self._read():
                pass
        if self.amplifier.boots != self._boots:
            self._boots, self._outbox = self.amplifier.boots, []
            self._rebooted()
        if self._cut != "refused":
            for link, data in self._read():
                if self._cut == "late":
                    self._held.add((link, data), time.monotonic_ns())
                elif self._cut != "hole":
                    self._hear(link, data)
            for link in self._links():
                for answer in link.say():
                    if time.monotonic() >= link.deaf_until_s:
                        self._send(link, 0.0, answer)
        while self._outbox and self._outbox[0][0] <= time.monotonic():
            _, _, link, data = heapq.heappop(self._outbox)
            if self._cut not in ("hole", "late", "deaf", "refused") and self.amplifier.hears:
                with suppress(OSError):
                    self._write(link, data)

    def _hear(self, link, data):
        if self.amplifier.hears and time.monotonic() >= link.deaf_until_s:
            for late_s, answer in link.hear(data):
                self._send(link, late_s, answer)

    def _send(self, link, late_s, answer):
        self._number += 1
        heapq.heappush(self._outbox, (time.monotonic() + late_s, self._number, link, answer))

    def _conversation(self):
        link = self._converse(self.amplifier)
        link.deaf_until_s = time.monotonic() + self.amplifier.habits.opening_ms * 1e-3
        return link

    def _rebooted(self):
        """What was connected isn't any more."""
        self._break()


class TcpPort(Port):
    """A server of one device."""

    def _open(self):
        if not hasattr(self, "_keeper"):
            self._connected = {}
            self._keeper = _bound(("127.0.0.1", 0))  # never listens: nobody else is given its number while it's refused
            self.place = self._keeper.getsockname()[1]
        self._listener = _bound(self._keeper.getsockname())
        self._listener.listen(8)

    def _close(self):
        if self._listener is not None:
            self._listener.close()
            self._listener = None
        if self._ending.is_set():
            self._keeper.close()

    def _break(self):
        for end in [*self._connected]:
            end.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, _RESET)
            self._drop(end)

    def _drop(self, end):
        self._connected.pop(end)
        end.close()

    def _ends(self):
        return [*self._connected, *([self._listener] if self._listener and self.amplifier.on else [])]

    def _links(self):
        return [*self._connected.values()]

    def _read(self):
        ready, _, _ = select.select(self._ends(), [], [], 0.0)
        for end in ready:
            if end is self._listener:
                if self._cut not in ("hole", "late"):
                    front, _ = end.accept()
                    front.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
                    self._connected[front] = self._conversation()
                continue
            link = self._connected[end]
            try:
                data = end.recv(_READ_BYTES)
            except OSError:
                data = b""
            if data:
                yield link, data
            else:
                self._drop(end)

    def _write(self, link, data):
        for end, each in self._connected.items():
            if each is link:
                end.sendall(data)


class Terminal(Port):
    """A serial line: a pseudo terminal behind a name; it sees whenever somebody opens it."""

    def __init__(self, amplifier, converse, place):
        self.place = place
        super().__init__(amplifier, converse)

    def _open(self):
        self._master, self._slave = os.openpty()  # ours stays open: then nothing ends when the controller closes it
        tty.setraw(self._slave)
        os.set_blocking(self._master, False)
        name = os.ttyname(self._slave)
        libc = ctypes.CDLL(None)
        self._watch = libc.inotify_init1(os.O_NONBLOCK)
        libc.inotify_add_watch(self._watch, name.encode(), _IN_OPEN)
        self._link = self._conversation()
        self.place.symlink_to(name)

    def _close(self):
        if self._master is not None:
            self.place.unlink()
            for descriptor in (self._master, self._slave, self._watch):
                os.close(descriptor)
            self._master = None

    def _break(self):
        """A line is unplugged, and plugged in again under another name."""
        if self._cut == "reset":
            self._close()
            self._open()

    def _rebooted(self):
        self._link = self._conversation()

    def _ends(self):
        return [] if self._master is None else [self._master, self._watch]

    def _links(self):
        return [] if self._master is None else [self._link]

    def _read(self):
        if self._master is None:
            return
        with suppress(BlockingIOError):
            os.read(self._watch, _READ_BYTES)
            self._link = self._conversation()
        with suppress(OSError):
            yield self._link, os.read(self._master, _READ_BYTES)

    def _write(self, link, data):
        if self._master is not None and link is self._link:
            os.write(self._master, data)


class DatagramPort(Port):
    """Answers whoever sent last."""

    def _open(self):
        if not hasattr(self, "place"):
            self.place = 0
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.bind(("127.0.0.1", self.place))
        self._socket.setblocking(False)
        self.place, self._peer = self._socket.getsockname()[1], None
        self._link = self._conversation()

    def _close(self):
        self._socket.close()

    def _break(self):
        self._link = self._conversation()

    def _ends(self):
        return [self._socket] if self._socket.fileno() >= 0 else []

    def _links(self):
        return [self._link]

    def _read(self):
        with suppress(BlockingIOError):
            while True:
                data, self._peer = self._socket.recvfrom(_READ_BYTES)
                yield self._link, data

    def _write(self, link, data):
        if self._peer is not None and link is self._link:
            self._socket.sendto(data, self._peer)


def _bound(address):
    end = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
    end.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    end.bind(address)
    return end
