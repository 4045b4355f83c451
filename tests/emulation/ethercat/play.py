"""Slaves on an interface until this process is ended: python -m tests.emulation.ethercat.play INTERFACE LINE."""

import select
import sys
import time

from micromanip.emulation.ethercat.line import Line

from .terminals import LINES
from .wire import raw

if __name__ == "__main__":
    line, opened = Line(LINES[sys.argv[2]]), raw(sys.argv[1])
    sys.stdout.write("up\n")
    sys.stdout.flush()
    while True:
        ready = select.select([opened], [], [], 0.001)[0]
        now_ns = time.monotonic_ns()
        if ready and (back := line.passed(opened.recv(2048), now_ns)):
            opened.send(back)
        line.tick(now_ns)
