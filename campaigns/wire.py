"""The line to the device with a man in the middle: passes on, listens, and can be cut in several ways.

It knows nothing of the product: what it hears is read from the bytes of the protocol itself.
"""

import contextlib
import select
import socket
import struct
import threading

CUTS = ("reset", "refused", "hole", "late", "deaf")
"""reset: connections break, new ones are accepted. refused: as long as the cut lasts, there is no port either.
hole: connections stand, nothing goes either way, and what was sent is lost. late: the same, but what was sent to the
device arrives when the cut is mended, as TCP would have it. deaf: commands arrive, answers don't."""
READ_BYTES = 65536
LOOK_S = 0.05
_RESET = struct.pack("=ii", 1, 0)


class _Link:
    """One connection of the controller, and its continuation to the device."""

    def __init__(self, front, back, tap):
        self.front, self.back, self.tap = front, back, tap
        self.late = b""
        for end in (front, back):
            end.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)


class Wire:
    """Listens on a port of its own, in front of the device's."""

    def __init__(self, device_port, make_tap):
        """`make_tap` makes the one who listens to a connection."""
        self._device, self._make_tap = ("127.0.0.1", device_port), make_tap
        self._listener = None
        self._links = []
        self._cut = None
        self._lock = threading.RLock()
        self._keeper = _bound(("127.0.0.1", 0))
        """Never listens: while the port is refused, nobody else on this machine may be given its number."""
        self.place = self._keeper.getsockname()[1]
        self._listen()
        self._ending = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def _listen(self):
        listener = _bound(self._keeper.getsockname())
        listener.listen(8)
        self._listener = listener

    def cut(self, how):
        """Cut it, one of `CUTS`; it stays like this until `mend`."""
        with self._lock:
            self.mend()
            self._cut = how
            if how in ("reset", "refused"):
                for link in list(self._links):
                    self._drop(link, reset=True)
            if how == "refused":
                self._listener.shutdown(socket.SHUT_RDWR)  # at once: `_run` may be waiting on it, which keeps it open
                self._listener.close()
                self._listener = None

    def mend(self):
        """As before the cut; what was held back arrives."""
        with self._lock:
            self._cut = None
            if self._listener is None:
                self._listen()
            for link in list(self._links):
                data, link.late = link.late, b""
                self._forward(link, data)
                if link.front.fileno() < 0:
                    self._drop(link)

    def close(self):
        """End it."""
        self._ending.set()
        self._thread.join()
        with self._lock:
            for link in list(self._links):
                self._drop(link)
            if self._listener is not None:
                self._listener.close()
            self._keeper.close()

    def _run(self):
        while not self._ending.is_set():
            with self._lock:
                ends = {link.front: link for link in self._links if link.front.fileno() >= 0}
                ends |= {link.back: link for link in self._links}
                listener = self._listener if self._cut not in ("hole", "late") else None
            waited = [*ends, *([listener] if listener is not None else [])]
            try:
                ready, _, _ = select.select(waited, [], [], LOOK_S)
            except (OSError, ValueError):
                continue  # one of them was closed meanwhile
            with self._lock:
                for end in ready:
                    if end is listener:
                        self._accept()
                    elif end.fileno() >= 0 and ends[end] in self._links:
                        self._pass(ends[end], end)

    def _accept(self):
        if self._listener is None:
            return
        front, _ = self._listener.accept()
        try:
            back = socket.create_connection(self._device, 5.0)
        except OSError:
            front.close()
            return
        self._links.append(_Link(front, back, self._make_tap()))

    def _pass(self, link, end):
        try:
            data = end.recv(READ_BYTES)
        except OSError:
            data = b""
        if not data and end is link.front and link.late:
            link.front.close()  # what it sent before is still on its way
        elif not data:
            self._drop(link)
        elif end is link.front:
            if self._cut == "late":
                link.late += data
            elif self._cut != "hole":
                self._forward(link, data)
        else:
            link.tap.from_device(data)
            if self._cut not in ("hole", "late", "deaf"):
                with contextlib.suppress(OSError):
                    link.front.sendall(data)

    def _forward(self, link, data):
        with contextlib.suppress(OSError):
            link.back.sendall(link.tap.to_device(data))

    def _drop(self, link, *, reset=False):
        self._links.remove(link)
        if reset and link.front.fileno() >= 0:
            link.front.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, _RESET)
        link.front.close()
        link.back.close()  # in order: what was passed on arrives


def _bound(address):
    end = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
    end.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    end.bind(address)
    return end
