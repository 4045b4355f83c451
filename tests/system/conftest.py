"""The service installed once on the throw-away machine, by its own command; each scenario begins with it stopped.

And CAN drivers on its vcan0, used by nobody.
"""

import os
import shutil
import time

import pytest

from tests.cells import WAITING, calm, changed

from .machine import PROGRAM, UNIT, Service, done, ok
from .vcan import set_link
from .vm_cell import DATABASES, FRAMES

NOBODY = 65534
TEXT = changed(calm(*WAITING), ("    driver: simulated\n", "    driver: simulated\n    device: bench\n"))


@pytest.fixture(scope="session")
def installed(tmp_path_factory):
    """The unit, an operator in its group, and a stranger."""
    service = Service()
    file = tmp_path_factory.mktemp("cell") / "cell.yaml"
    file.write_text(TEXT)
    service.installation = ok(PROGRAM, "system", "install", str(file), "--yes")
    ok("useradd", "--create-home", "--groups", "micromanip", "cell-operator")
    ok("useradd", "--create-home", "passer-by")
    for name in ("runs-it", "looks-on"):  # each in a group of its own, of the same name
        ok("useradd", "--create-home", "--user-group", name)
    ok("systemctl", "start", UNIT)  # compiles; what that takes is then there for the operator too
    ok("systemctl", "stop", UNIT)
    ok("cp", "-r", "/var/cache", "/home/cell-operator/.cache")
    ok("chown", "-R", "cell-operator:", "/home/cell-operator/.cache")
    return service


@pytest.fixture
def service(installed):
    installed.since = f"{time.time():.6f}"
    yield installed
    installed.release()
    done("systemctl", "stop", UNIT)
    done("systemctl", "reset-failed", UNIT)
    installed.drop_in()


@pytest.fixture(scope="session")
def databases():
    """The DBC files where everybody may read them, which the folder of the sources need not be."""
    shutil.copytree(DATABASES, FRAMES)


@pytest.fixture
def nobody(databases):
    """The scenario has no rights at all; what it does by `ok` is done by root all the same."""
    groups = os.getgroups()
    os.setgroups([])
    os.setegid(NOBODY)
    os.seteuid(NOBODY)
    yield
    os.seteuid(0)
    os.setegid(0)
    os.setgroups(groups)


@pytest.fixture
def opened():
    """Drivers and links that are closed at the end, and vcan0 as it was."""
    buses = []

    def open_one(bus):
        buses.append(bus)
        bus.open()
        return bus

    yield open_one
    for bus in buses:
        bus.close()
    set_link("up")
