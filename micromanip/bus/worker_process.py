"""The worker process of one bus.

Started by the host as ``python -m micromanip.bus.worker_process`` in a session of its own. Its orders are the first
line on standard input, a JSON document; each further line has new rules. When standard input ends, the host is gone or
wants it to end: it then goes on until the loop is silent and the outputs are at rest, however long a hold lasts. What
happens it tells on standard output, a JSON document a line.
"""

from __future__ import annotations

import gc
import os
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext, suppress
from pathlib import Path
from typing import Any

from micromanip.errors import ConfigError, PermissionDenied
from micromanip.rt.bus_image import ALIVE_NS

from .driver import BusDriver
from .image import ProcessImage
from .last_given import LastGiven
from .registry import driver_class
from .report import Orders, first_orders, tell
from .rights import leave_cpu, lock_memory, stay_on_cpu
from .safe_state import SafeOutput
from .worker import Rules, Worker

_STUCK_S, _LOOK_S = 30.0, 1.0
"""With the host gone, a driver that does not come back from its bus for so long is ended."""


def _listen(worker: Worker, image: ProcessImage, told: Orders) -> None:
    """Take new rules; end with the host, and if the driver does not come back from its bus, end all the same."""
    while (order := told.next()) is not None:
        worker.adopt(_rules(order["rules"]))
    worker.end()
    while time.monotonic() - image.ask(ALIVE_NS) * 1e-9 < _STUCK_S:
        time.sleep(_LOOK_S)
    os._exit(70)


def _rules(document: dict[str, Any]) -> Rules:
    return Rules(**{**document, "outputs": [SafeOutput(**output) for output in document["outputs"]]})


def _memory(driver: BusDriver, folder: Path) -> LastGiven | None:
    """What outlives all processes; None, which is told, where there can't be any."""
    names = [channel.name for channel in driver.outputs]
    if not names:
        return None
    try:
        return LastGiven.open(driver.device, names, folder)
    except PermissionDenied as problem:
        tell("rights", str(problem))
        return None


def main() -> int:
    """Serve until the end; the exit code is 0, 78 for options that the driver refuses, 1 after a bug."""
    os.set_blocking(1, False)
    told, orders = first_orders()
    if orders is None:
        return 0
    kind = driver_class(orders["driver"])
    assert issubclass(kind, BusDriver)
    try:
        options = kind.Options.model_validate_json(orders["options"])
        driver = kind(options, Path(orders["folder"]))
    except ConfigError as problem:
        sys.stderr.write(f"{problem}\n")
        return problem.exit_code
    image = ProcessImage.attach(orders["descriptor"], orders["offset"])
    image.take_over()
    memory = _memory(driver, Path(orders["memory"]))
    at_ease = take_rights(orders["cpu"], orders["loop_cpu"], orders["priority"])
    worker = Worker(driver, image, _rules(orders["rules"]), memory, at_ease, simulated=options.simulated)
    threading.Thread(target=_listen, args=(worker, image, told), daemon=True).start()
    gc.collect()
    gc.freeze()
    worker.run()
    return 0


def take_rights(cpu: int | None, loop_cpu: int | None, priority: int) -> Callable[[], AbstractContextManager[None]]:
    """On its own CPU, or off the loop's, memory locked, urgent but less than the loop; what is at ease for a while.

    As far as allowed: what is refused is told. To open a driver takes long: what else runs on this CPU, other buses
    among it, must not wait for that.
    """
    if cpu is None:
        leave_cpu(loop_cpu)
    elif not stay_on_cpu(cpu):
        tell("rights", f"its worker is not pinned to CPU {cpu}: it does not exist or is not allowed")
    lock_memory(once_touched=True)
    urgent = os.sched_param(priority)
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, urgent)
    except PermissionError:
        tell("rights", "no real-time priority for its worker: samples and voltages may come late")
        return nullcontext

    @contextmanager
    def at_ease() -> Iterator[None]:
        os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
        try:
            yield
        finally:
            for thread in os.listdir("/proc/self/task"):  # noqa: PTH208 (those that the driver began are as urgent)
                with suppress(ProcessLookupError):
                    os.sched_setscheduler(int(thread), os.SCHED_FIFO, urgent)

    return at_ease


if __name__ == "__main__":
    sys.exit(main())
