"""micromanip.service in the virtual machine, installed for an emulated processor."""

import shutil

from .machine import CONFIG, PROGRAM, Service, ok
from .vm_cell import DATABASES

# Opens a serial port, as drivers do, in the very sandbox of the unit.
_OPEN = "import os; os.open('/dev/ttyS0', os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)"
_UNIT = (
    "Environment=NUMBA_CPU_NAME=generic NUMBA_CPU_FEATURES=",
    *("WatchdogSec=60", "TimeoutStartSec=20min"),  # an emulated processor is in no hurry
    f'ExecStartPre=/opt/micromanip/bin/python -c "{_OPEN}"',
)


def installed(file):
    """The service for the configuration `file`, with what was compiled outside."""
    service = Service()
    CONFIG.parent.mkdir(parents=True, exist_ok=True)
    shutil.copy(DATABASES / "manipulator.dbc", CONFIG.parent)
    ok(PROGRAM, "system", "install", str(file), "--yes")
    shutil.copytree("/kept/micromanip", "/var/cache/micromanip", dirs_exist_ok=True)
    ok("chown", "-R", "micromanip:micromanip", "/var/cache/micromanip")
    for device, group in (("ttyS0", "dialout"), ("cpu_dma_latency", "micromanip")):  # as udev does; none runs here
        ok("chgrp", group, f"/dev/{device}")
        ok("chmod", "660", f"/dev/{device}")
    service.drop_in(*_UNIT)
    return service
