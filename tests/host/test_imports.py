"""What a process need not load it does not: only the loop has a compiler, and a command that asks starts quickly."""

import os
import subprocess
import sys

COMPILER = ("numba", "llvmlite")
HEAVY = (*COMPILER, "scipy", "matplotlib", "pydantic", "numpy")


def loaded(program, names, **environment):
    """Which of `names` a fresh Python has after `program`."""
    done = subprocess.run(
        [sys.executable, "-c", f"import sys\n{program}\nprint(*(n for n in {names!r} if n in sys.modules))"],
        capture_output=True, text=True, timeout=300, check=True, env=os.environ | environment,
    )  # fmt: skip
    return done.stdout.splitlines()[-1].split()


def test_only_the_loop_has_a_compiler():
    program = """
import micromanip.host.daemon
import micromanip.cli.check
import micromanip.bus.worker_process
"""
    assert loaded(program, COMPILER) == []


def test_who_reads_the_ring_needs_numpy_only():
    program = """
import micromanip.host.recording.recorder
import micromanip.host.trips.process
"""
    assert loaded(program, HEAVY) == ["numpy"]


def test_who_only_shows_loads_no_scipy():
    assert loaded("import micromanip.gateway.serving", ("numba", "scipy")) == []


def test_what_asks_starts_quickly(tmp_path):
    program = """
from micromanip.cli.main import main
for arguments in (["--help"], ["status", "--help"], ["status", "--socket", "/nowhere"]):
    try:
        main(arguments)
    except SystemExit:
        pass
"""
    assert loaded(program, HEAVY, STATE_DIRECTORY=str(tmp_path)) == []
