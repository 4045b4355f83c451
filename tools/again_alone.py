"""A plugin of pytest: a ``live`` test that fails beside others is tried again alone, in processes of its own.

It waits for processes, links and clocks of a machine that the other tests keep busy; and what it shares with other
tests, a daemon that tracks, is as the failed try left it. Alone, it gets both anew. Any other failure is final.
``pytest -p tools.again_alone``; the failures stay in the summary, the exit code is that of what is left.
"""

import re
import subprocess
import sys

import pytest

TRIES = 2
MOST = 25
"""More failures than this are no accident."""


class _AgainAlone:
    """Collects what fails; has it run again when the session is over."""

    def __init__(self):
        self.failed, self.final = {}, False

    def pytest_runtest_logreport(self, report):
        if report.failed:
            self.failed[re.sub(r"@[^\[\]]*$", "", report.nodeid)] = None  # pytest-xdist appends its group
            self.final |= "live" not in report.keywords

    def pytest_collectreport(self, report):
        self.final |= report.failed

    @pytest.hookimpl(wrapper=True, tryfirst=True)  # behind the summary
    def pytest_sessionfinish(self, session, exitstatus):
        yield
        if exitstatus == pytest.ExitCode.TESTS_FAILED and not self.final and 0 < len(self.failed) <= MOST:
            left = [name for name in self.failed if not any(_passes(name) for _ in range(TRIES))]
            print(f"of {len(self.failed)} live tests that failed beside others these failed alone, too: {left}")
            if not left:
                session.exitstatus = pytest.ExitCode.OK


def _passes(name):
    print(f"alone: {name}", flush=True)
    return subprocess.run([sys.executable, "-m", "pytest", "-n", "0", name], check=False).returncode == 0


def pytest_configure(config):
    """Where the results come together, not in the workers of pytest-xdist."""
    if not hasattr(config, "workerinput"):
        config.pluginmanager.register(_AgainAlone())
