"""What a process asks of the kernel, tried in a process of its own."""

import resource
import subprocess
import sys

import pytest

LOCKED = """
import sys
from micromanip.bus import rights
if "limited" in sys.argv:
    rights._has_capability = lambda number: False
got = rights.lock_memory(once_touched="touched" in sys.argv)
more = bytearray(8 << 20)
locked = next(line for line in open("/proc/self/status") if line.startswith("VmLck"))
print(got, locked.split()[1])
"""


def locked(*how, before=None):
    command = [sys.executable, "-c", LOCKED, *how]
    done = subprocess.run(command, capture_output=True, text=True, check=True, timeout=60, preexec_fn=before)
    got, kilobytes = done.stdout.split()
    return got == "True", int(kilobytes)


@pytest.mark.parametrize("how", ["touched", "all"])
def test_all_memory_is_locked_that_which_comes_later_too(how):
    got, kilobytes = locked(how)
    if not got:
        pytest.skip("no right to lock memory here")
    assert kilobytes > 8 << 10


def test_with_a_limit_nothing_is_locked_and_nothing_fails_later():
    def limit():
        _, most = resource.getrlimit(resource.RLIMIT_MEMLOCK)
        resource.setrlimit(resource.RLIMIT_MEMLOCK, (1 << 16, most))

    assert locked("touched", "limited", before=limit) == (False, 0)


RESTORED = """
import os
from micromanip.bus import rights
before = os.getpriority(os.PRIO_PROCESS, 0), os.sched_getaffinity(0)
with rights.precedence_restored():
    went = rights.go_before_ordinary_work(-10)
    rights.leave_cpu(min(before[1]))
    locked = rights.lock_memory(once_touched=True)
    meanwhile = os.getpriority(os.PRIO_PROCESS, 0), os.sched_getaffinity(0)
assert not went or meanwhile[0] == -10
assert len(before[1]) == 1 or meanwhile[1] < before[1]
assert (os.getpriority(os.PRIO_PROCESS, 0), os.sched_getaffinity(0)) == before
more = bytearray(8 << 20)
assert next(line for line in open("/proc/self/status") if line.startswith("VmLck")).split()[1] == "0"
"""


def test_a_process_that_was_the_host_for_a_while_is_an_ordinary_one_again():
    subprocess.run([sys.executable, "-c", RESTORED], check=True, timeout=60)


OF_THE_SESSION = """
import os, pathlib
from micromanip.bus import rights
shares = pathlib.Path("/proc/self/autogroup")
before = shares.read_text() if shares.exists() else ""
os.nice(5)
with rights.precedence_restored():
    went = rights.go_before_ordinary_work(-10)
    meanwhile = shares.read_text() if before else ""
print(went, meanwhile.strip(), before.strip(), shares.read_text().strip() if before else "", sep=";")
"""


def test_who_runs_the_host_with_nice_gets_the_session_back_as_it_was():
    done = subprocess.run(
        [sys.executable, "-c", OF_THE_SESSION], capture_output=True, text=True, check=True, timeout=60,
        start_new_session=True,
    )  # fmt: skip
    went, meanwhile, before, after = done.stdout.strip().split(";")
    if went == "False" or not before:
        pytest.skip("no right to go before others, or no shares by session here")
    assert meanwhile.endswith("nice -10")
    assert after == before
