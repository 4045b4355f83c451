"""Shared by all tests: how hypothesis searches, and which tests need compiled code.

The laws' tests run in three modes: compiled, with bounds checks (NUMBA_BOUNDSCHECK=1) and as plain
Python (NUMBA_DISABLE_JIT=1), where a cycle costs a hundred times more and the search is shorter.
``--hypothesis-profile=explore`` searches longer, and elsewhere in each run; ``soak`` takes ten thousand steps of a
state machine; ``mutation`` does not ask for the smallest example.
"""

from pathlib import Path

import pytest
from hypothesis import HealthCheck, Phase, settings

from micromanip.rt.jit import PLAIN, Compiled

JIT = not PLAIN
Compiled.laws_compiled = True  # what the laws' tests call is the machine code, not the Python of the same law

_COMMON = {"deadline": None, "suppress_health_check": [HealthCheck.too_slow], "print_blob": True}
settings.register_profile("steady", max_examples=60 if JIT else 15, derandomize=True, database=None, **_COMMON)
_QUICK = {"phases": (Phase.explicit, Phase.generate), "max_examples": 15, "derandomize": True, "database": None}
settings.register_profile("mutation", **_QUICK, **_COMMON)
settings.register_profile("explore", max_examples=1000 if JIT else 100, database=None, **_COMMON)
settings.register_profile("soak", max_examples=100, stateful_step_count=100, database=None, **_COMMON)
settings.load_profile("steady")


@pytest.fixture(autouse=True, scope="session")
def _own_state_directory(tmp_path_factory):
    """No test writes into the audit trail of the user who runs it."""
    with pytest.MonkeyPatch.context() as patch:
        patch.delenv("STATE_DIRECTORY", raising=False)
        patch.setenv("XDG_STATE_HOME", str(tmp_path_factory.mktemp("state")))
        yield


def pytest_addoption(parser):
    parser.addoption("--garbage", type=int, default=5_000, help="how many inputs the control socket is tried with")


def pytest_configure(config):
    config.addinivalue_line("markers", "compiled_only: needs compiled code, left out under NUMBA_DISABLE_JIT=1")


REAL = ("bus", "cli", "drivers", "hil", "host", "emulation", "surprise")
"""Here are real processes, sockets and pseudo terminals on a machine that others share, which may stall for a while."""


def pytest_collection_modifyitems(config, items):
    """What failed where a stall can be the cause is tried once more, and the summary counts it."""
    for item in items:
        if item.path.relative_to(Path(__file__).parent).as_posix().startswith(REAL):
            item.add_marker(pytest.mark.flaky(reruns=1))
    if JIT:
        return
    skip = pytest.mark.skip(reason="needs compiled code (NUMBA_DISABLE_JIT is set)")
    for item in items:
        if "compiled_only" in item.keywords:
            item.add_marker(skip)
