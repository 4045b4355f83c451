"""Shared by all tests: how hypothesis searches, and which tests need compiled code.

The laws' tests run compiled and as plain Python (NUMBA_DISABLE_JIT=1), where a cycle costs a hundred times more and
the search is shorter; in ``make thorough`` also with bounds checks of compiled code (NUMBA_BOUNDSCHECK=1).
``--hypothesis-profile=thorough`` searches longer (``make thorough``); ``explore`` still longer, and elsewhere in each
run; ``soak`` takes ten thousand steps of a state machine; ``mutation`` does not ask for the smallest example.
"""

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # as the Makefile: small matrices, and twice the CPU without

import contextlib
import functools
import gc

import pytest
from hypothesis import HealthCheck, Phase, settings

from micromanip.rt.jit import PLAIN, Compiled
from micromanip.settings.text import yaml_nodes

JIT = not PLAIN
yaml_nodes.compose = functools.lru_cache(64)(yaml_nodes.compose)  # the same few files, read a thousand times
Compiled.laws_compiled = True  # what the laws' tests call is the machine code, not the Python of the same law

_COMMON = {"deadline": None, "suppress_health_check": [HealthCheck.too_slow], "print_blob": True}
_STEADY = {"derandomize": True, "database": None, **_COMMON}
settings.register_profile("steady", max_examples=25 if JIT else 10, **_STEADY)
settings.register_profile("thorough", max_examples=60 if JIT else 15, **_STEADY)
settings.register_profile("mutation", max_examples=15, phases=(Phase.explicit, Phase.generate), **_STEADY)
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


@pytest.fixture
def closing():
    """Closes what it is given when the test has ended, and hands it on."""
    with contextlib.ExitStack() as stack:
        yield lambda made: stack.enter_context(contextlib.closing(made))


def pytest_addoption(parser):
    parser.addoption("--kills", type=int, default=3, help="how often a recorder is killed")
    parser.addoption("--garbage", type=int, default=5_000, help="how many inputs the control socket is tried with")


def pytest_configure(config):
    for marker in (
        "compiled_only: needs compiled code, left out under NUMBA_DISABLE_JIT=1",
        "live: on real processes, links or clocks, which it waits for; left out of `make check`",
        "long: computes for seconds; left out of `make check`",
        "many_cycles: takes seconds as plain Python, and runs so in `make thorough` only",
        "thorough: one more case of what another one shows; left out of `make test`, which `make thorough` is for",
        "realtime: live, and judges time-outs or a real loop; run one after the other, behind all others",
    ):
        config.addinivalue_line("markers", marker)


def _shares(item):
    """Where the widest fixture stands that `item` has in common with other tests; None where it has all for itself."""
    found = item._fixtureinfo.name2fixturedefs.values() if hasattr(item, "_fixtureinfo") else ()
    shared = [each[-1] for each in found if each[-1].scope != "function" and each[-1].baseid not in ("", "tests")]
    return min((each.baseid for each in shared), key=len, default=None)


@pytest.hookimpl(tryfirst=True)  # before pytest-xdist looks for the groups
def pytest_collection_modifyitems(items):
    for item in items:
        if "realtime" in item.keywords:
            item.add_marker("live")
        # what tests share, a daemon or a commissioned cell, is made by one worker, not by each
        if "xdist_group" not in item.keywords and (shares := _shares(item)):
            item.add_marker(pytest.mark.xdist_group(shares))
        if "compiled_only" in item.keywords and not JIT:
            item.add_marker(pytest.mark.skip(reason="needs compiled code (NUMBA_DISABLE_JIT is set)"))
    items[:] = _evenly_mixed(items)


def _evenly_mixed(items):
    """`items` with those that wait, those that compute for long and the short ones each spread over the whole run.

    Each worker takes the next one: were all that wait in a row, no worker would compute meanwhile.
    """
    kinds = ([], [], [])
    for item in items:
        kinds[0 if "live" in item.keywords else 1 if "long" in item.keywords else 2].append(item)
    places = {item: i / len(kind) for kind in kinds for i, item in enumerate(kind)}
    return sorted(items, key=places.__getitem__)


def pytest_collection():
    """What is imported and collected stays: no search for garbage, now or later, looks at it."""
    gc.disable()


def pytest_collection_finish():
    gc.enable()
    gc.freeze()
