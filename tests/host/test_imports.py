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


def test_a_host_that_prepares_a_run_has_none():
    """Nor scipy, which would be a quarter of its start."""
    program = """
from pathlib import Path
from micromanip.host.controller import Controller
from micromanip.settings.check import prepare
import micromanip.host.daemon
assert prepare(Path("config/serial.yaml")).configuration.axes["x"].outer is not None
controller = Controller(prepare(Path("config/simulated.yaml")), Path("unused"))
assert controller.make_safe() == {"cell": 0}
"""
    assert loaded(program, (*COMPILER, "scipy")) == []


def test_the_loop_loads_no_linear_algebra():
    """Which numba would look for as it compiles; nor all that numba can compile, where the loop's code is kept."""
    program = """
from micromanip.host.loop_process import run_loop, without_blas
from micromanip.rt.jit import Compiler, prepare
had_to_be_compiled = []
Compiler.tell = staticmethod(had_to_be_compiled.append)
with without_blas():
    prepare(run_loop)
before = "scipy.linalg" in sys.modules
assert had_to_be_compiled or "numba.np.linalg" not in sys.modules
import scipy.linalg
assert not before
"""
    assert loaded(program, ["numba", "scipy.linalg"]) == ["numba", "scipy.linalg"]


def test_who_only_shows_loads_no_scipy():
    assert loaded("import micromanip.gateway.serving", ("numba", "scipy")) == []


def test_a_worker_ramps_its_outputs_to_rest_without_one():
    program = """
from micromanip.bus.safe_state import VOLTAGE, SafeOutput, SafeState
state = SafeState([SafeOutput(VOLTAGE, 0.0, -20.0, 150.0, 1e4)], [1e-3], 0.1, 1)
state.read_back([80.0])
state.given([0], state.values([0.0], 0, 2))
assert 0.0 < state.values([0.0], 0, 2)[0] < 80.0
"""
    assert loaded(program, COMPILER) == []


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
