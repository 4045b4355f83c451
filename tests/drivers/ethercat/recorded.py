"""What goes over an interface, in a file for tshark; and what tshark says of it."""

import select
import socket
import struct
import subprocess
import threading
import time

_EVERYTHING, _QUEUE_BYTES = 3, 1 << 24
_HEAD = struct.pack("<IHHiIII", 0xA1B23C4D, 2, 4, 0, 0, 65535, 1)
"""Of a file of pcap: with ns, Ethernet."""
AMISS = "_ws.expert || _ws.malformed || ecat_mailbox.invalid || ecat_mailbox.coe.invalid || !ecat"
"""Whatever tshark complains of, or does not understand; a mail that is none is no expert information."""


class Recorded:
    """A file with all frames, both ways, while the ``with`` lasts."""

    def __init__(self, interface, file):
        self._socket = socket.socket(socket.AF_PACKET, socket.SOCK_RAW, socket.htons(_EVERYTHING))
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _QUEUE_BYTES)
        self._socket.bind((interface, _EVERYTHING))
        self.file, self._done = file, threading.Event()
        self._thread = threading.Thread(target=self._write)

    def _write(self):
        with self.file.open("wb") as out:
            out.write(_HEAD)
            while (waiting := select.select([self._socket], [], [], 0.05)[0]) or not self._done.is_set():
                if waiting:
                    frame, now_ns = self._socket.recv(4096), time.time_ns()
                    out.write(struct.pack("<4I", *divmod(now_ns, 10**9), len(frame), len(frame)) + frame)

    def __enter__(self):
        self._thread.start()
        return self

    def __exit__(self, *_):
        self._done.set()
        self._thread.join()
        self._socket.close()


def dissected(file, *fields, only=""):
    """Each frame, or those that a filter lets through, by field: what tshark makes of it, as text."""
    chosen = [each for field in fields for each in ("-e", field)]
    found = subprocess.run(
        ["tshark", "-n", "-r", str(file), *(("-Y", only) if only else ()), "-T", "fields", *chosen],
        capture_output=True,
        text=True,
        check=True,
    )
    return [dict(zip(fields, line.split("\t"), strict=False)) for line in found.stdout.splitlines()]
