"""micromanip.service in the virtual machine, installed for an emulated processor."""

import shutil

from .machine import PROGRAM, Service, ok

_SLOW = (
    "Environment=NUMBA_CPU_NAME=generic NUMBA_CPU_FEATURES=",
    *("WatchdogSec=60", "TimeoutStartSec=20min"),  # an emulated processor is in no hurry
)


def installed(file, *settings):
    """The service for the configuration `file`, with what was compiled outside; `settings` go into the unit."""
    service = Service()
    service.since = "0"
    ok(PROGRAM, "install-service", str(file), "--yes")
    shutil.copytree("/kept/micromanip", "/var/cache/micromanip", dirs_exist_ok=True)
    ok("chown", "-R", "micromanip:micromanip", "/var/cache/micromanip")
    for device, group in (("ttyS0", "dialout"), ("cpu_dma_latency", "micromanip")):  # as udev does; none runs here
        ok("chgrp", group, f"/dev/{device}")
        ok("chmod", "660", f"/dev/{device}")
    service.drop_in(*_SLOW, *settings)
    return service
