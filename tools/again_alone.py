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
        self.live = {}
        """Node names of failed live tests, in their order."""
        self.final = False

    def pytest_runtest_logreport(self, report):
        if report.failed:
            self.live[re.sub(r"@[^\[\]]*$", "", report.nodeid)] = None  # pytest-xdist appends its group
            self.final |= "live" not in report.keywords

    def pytest_collectreport(self, report):
        self.final |= report.failed

    @pytest.hookimpl(wrapper=True, tryfirst=True)  # behind the summary
    def pytest_sessionfinish(self, session, exitstatus):
        yield
        if exitstatus != pytest.ExitCode.TESTS_FAILED or self.final or not self.live:
            return
        if len(self.live) > MOST:
            print(f"{len(self.live)} live tests failed: too many to be tried alone")
            return
        left = [name for name in self.live if not _passes(name)]
        print(f"of {len(self.live)} live tests that failed beside others, {len(self.live) - len(left)} passed alone")
        for name in left:
            print(f"FAILED {name}, alone too")
        if not left:
            session.exitstatus = pytest.ExitCode.OK


def _passes(name):
    for _ in range(TRIES):
        print(f"alone: {name}", flush=True)
        if subprocess.run([sys.executable, "-m", "pytest", "-n", "0", name], check=False).returncode == 0:
            return True
    return False


def pytest_configure(config):
    """Where the results come together, not in the workers of pytest-xdist."""
    if not hasattr(config, "workerinput"):
        config.pluginmanager.register(_AgainAlone())
