"""Slaves on an interface until this process is ended: python -m tests.emulation.ethercat.play INTERFACE LINE.

The pins of the digital ones are wired: what both output terminals put out is what the input terminal reads.
"""

import select
import sys
import time

from micromanip.emulation.ethercat.line import Line
from micromanip.emulation.ethercat.terminal import DIGITAL_INPUTS, DIGITAL_OUTPUTS

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
        if sys.argv[2] == "digital":
            low, high, read = (application.memory for application in line.applications)
            read[DIGITAL_INPUTS] = low[DIGITAL_OUTPUTS] & 0x0F | high[DIGITAL_OUTPUTS] << 4
        line.tick(now_ns)
