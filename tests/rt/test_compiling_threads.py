"""Two threads that compile at the same time: each gets its code, none waits for ever."""

import os
import subprocess
import sys

import pytest

pytestmark = [pytest.mark.compiled_only, pytest.mark.live]  # in a process of its own

CALLED = ["x", *(f"law_{k}(x)" for k in range(19))]
LAWS = "".join(f"@compiler\ndef law_{k}(x):\n    return {called} + {k}.0\n\n\n" for k, called in enumerate(CALLED))
PROGRAM = f"""\
import threading
import time
from micromanip.rt.jit import Compiler

compiler = Compiler(__file__, allocates=True)


{LAWS}@compiler.entry("f8(f8)")
def step(x):
    return law_3(x)


found = []
first = threading.Thread(target=lambda: found.append(law_19(0.0)))
first.start()
while law_19.__dict__.get("dispatcher") is None:
    time.sleep(0.001)
time.sleep(0.02)
second = threading.Thread(target=lambda: found.append(step(0.0)))
second.start()
first.join()
second.join()
print(*sorted(found))
"""


def test_threads_that_compile_do_not_wait_for_each_other(tmp_path):
    program = tmp_path / "package" / "program.py"
    program.parent.mkdir()
    program.write_text(PROGRAM)
    done = subprocess.run(
        [sys.executable, "-c", f"import runpy; runpy.run_path({str(program)!r})"],
        env=os.environ | {"XDG_CACHE_HOME": str(tmp_path)},
        capture_output=True, text=True, timeout=240, check=False,
    )  # fmt: skip
    assert done.stderr == ""
    assert done.stdout == "6.0 190.0\n"
