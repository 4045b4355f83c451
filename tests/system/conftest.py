"""The service installed once on the throw-away machine, by its own command; each scenario begins with it stopped."""

import time

import pytest
from host.cell import WAITING, calm, changed

from .machine import PROGRAM, UNIT, Service, done, ok

TEXT = changed(calm(*WAITING), ("    driver: simulated\n", "    driver: simulated\n    device: bench\n"))


@pytest.fixture(scope="session")
def installed(tmp_path_factory):
    """The unit, an operator in its group, and a stranger."""
    service = Service()
    file = tmp_path_factory.mktemp("cell") / "cell.yaml"
    file.write_text(TEXT)
    service.installation = ok(PROGRAM, "install-service", str(file), "--yes")
    ok("useradd", "--create-home", "--groups", "micromanip", "cell-operator")
    ok("useradd", "--create-home", "passer-by")
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
