"""Ordinary work on every CPU, as a cell's computer may have it: hashing, copying, files, processes that come and go."""

from __future__ import annotations

import contextlib
import os
import subprocess
import sys
from collections.abc import Iterator

_WORK = """
import hashlib, os, subprocess, sys, tempfile, time
parent, end = os.getppid(), time.monotonic() + float(sys.argv[1])
block = bytearray(32 << 20)
while time.monotonic() < end and os.getppid() == parent:
    hashlib.sha256(block[: 4 << 20]).digest()
    bytes(block)
    with tempfile.TemporaryFile() as file:
        file.write(block[: 1 << 20])
        os.fsync(file.fileno())
    subprocess.run(["true"])
"""


@contextlib.contextmanager
def loaded(longest_s: float) -> Iterator[int]:
    """Load while it is entered, by as many processes as there are CPUs; their number.

    They end by themselves with this process, or after `longest_s`.
    """
    count = len(os.sched_getaffinity(0))
    command = [sys.executable, "-I", "-S", "-c", _WORK, str(longest_s)]
    workers = [subprocess.Popen(command, stdin=subprocess.DEVNULL) for _ in range(count)]
    try:
        yield count
    finally:
        for worker in workers:
            worker.kill()
        for worker in workers:
            worker.wait()
