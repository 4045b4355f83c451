"""``null_modem.py HERE THERE``: two serial ports, joined; each is a link to a pseudo terminal, until it is killed."""

import contextlib
import os
import select
import shutil
import sys
import tty
from pathlib import Path

ends = {}
for path in sys.argv[1:3]:
    master, slave = os.openpty()
    tty.setraw(slave)  # held open: a port that nobody has open is not gone
    terminal = Path(os.ttyname(slave))
    terminal.chmod(0o660)
    shutil.chown(terminal, group="dialout")
    Path(path).symlink_to(terminal)
    os.set_blocking(master, False)
    ends[master] = path
here, there = ends
while True:
    for ready in select.select([here, there], [], [])[0]:
        with contextlib.suppress(BlockingIOError):  # nobody reads: it is lost, as on a line
            os.write(there if ready == here else here, os.read(ready, 4096))
