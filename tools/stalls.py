"""How long the machine stood still during a test: a process beside the tests sleeps, and notes how late it wakes.

A test that waits for processes and links is tried again only where that was so; where the machine ran, what failed is
the program's or the test's fault.
"""

import mmap
import os
import struct
import subprocess
import sys

STALL_MS = 10.0
"""From here on a time-out, a deadline or an age of some test may have been missed."""

_WATCH = """
import mmap, struct, sys, time
with mmap.mmap(int(sys.argv[1]), 8) as memory:
    while True:
        before = time.monotonic()
        time.sleep(0.004)
        late_ms = (time.monotonic() - before) * 1e3 - 4.0
        if late_ms > struct.unpack("<d", memory[:8])[0]:
            memory[:8] = struct.pack("<d", late_ms)
"""


class Stalls:
    """The longest stall since `begin`."""

    def __init__(self):
        descriptor = os.memfd_create("stalls")
        try:
            os.ftruncate(descriptor, 8)
            self._memory = mmap.mmap(descriptor, 8)
            self._watcher = subprocess.Popen(
                [sys.executable, "-c", _WATCH, str(descriptor)], pass_fds=(descriptor,), stdin=subprocess.DEVNULL
            )
        finally:
            os.close(descriptor)

    def begin(self):
        """From now on."""
        self._memory[:8] = struct.pack("<d", 0.0)

    @property
    def longest_ms(self):
        return struct.unpack("<d", self._memory[:8])[0]

    def end(self):
        """No watcher is left."""
        self._watcher.kill()
        self._watcher.wait()
