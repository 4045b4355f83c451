"""The end of `run`, once its loop has come to rest."""

import subprocess
import sys

ENDED = """
import asyncio, os, signal
from micromanip.cli import run
from micromanip.host import child, daemon
from micromanip.settings import check

class Process:
    async def begin(self): pass
    async def let_go(self): pass

async def served(*_):
    asyncio.get_running_loop().add_signal_handler(signal.SIGHUP, print)

child.loop_process, check.prepare, daemon.served = Process, str, served
daemon.Options = lambda *_: None
asyncio.run(run._run(None, None, None, None))
os.kill(os.getpid(), signal.SIGHUP)
print("its report")
"""


def test_a_reload_that_comes_too_late_takes_no_report_away():
    done = subprocess.run([sys.executable, "-c", ENDED], capture_output=True, text=True, check=False)
    assert done.stdout == "its report\n", done.stderr
