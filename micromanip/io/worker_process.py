"""The worker process of one bus.

Started by the host as ``python -m micromanip.io.worker_process`` in a session of its own. Its orders are the first line
on standard input, a JSON document; when standard input ends, the host is gone or wants it to end: it then goes on until
the loop is silent and the outputs are at rest. What happens it tells on standard output, a JSON document a line.
"""

from __future__ import annotations

import gc
import json
import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext, suppress
from pathlib import Path

from micromanip.errors import ConfigError

from .bus import BusDriver
from .image import ProcessImage
from .registry import driver_class
from .rights import leave_cpu, lock_memory, stay_on_cpu
from .safe_state import SafeOutput, SafeState
from .worker import LOOK_NS, Worker, say

_LEFT_ALONE_S = 30.0


def _listen(worker: Worker) -> None:
    """End with the host; and if the driver does not come back from its bus, end all the same."""
    os.read(0, 1)
    worker.end()
    time.sleep(_LEFT_ALONE_S)
    os._exit(70)


def main() -> int:
    """Serve until the end; the exit code is 0, 78 for options that the driver refuses, 1 after a bug."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    os.set_blocking(1, False)
    orders = json.loads(_first_line())
    kind = driver_class(orders["driver"])
    assert issubclass(kind, BusDriver)
    try:
        driver = kind(kind.Options.model_validate_json(orders["options"]), Path(orders["folder"]))
    except ConfigError as problem:
        sys.stderr.write(f"{problem}\n")
        return problem.exit_code
    image = ProcessImage.attach(orders["descriptor"], orders["offset"])
    image.take_over()
    outputs = [SafeOutput(**output) for output in orders["outputs"]]
    last, last_ns = image.sent()
    before = last[: len(outputs)] if last_ns else None
    safe = SafeState(outputs, orders["ramp_ns"], orders["dead_ns"], before, last_ns)
    look_ns = max(LOOK_NS, min(orders["dead_ns"], orders["patience_ns"]) // 5)
    at_ease = take_rights(orders["cpu"], orders["loop_cpu"], orders["priority"])
    worker = Worker(driver, image, safe, len(outputs), orders["patience_ns"], look_ns, at_ease)
    signal.signal(signal.SIGTERM, lambda *_: worker.end())
    threading.Thread(target=_listen, args=(worker,), daemon=True).start()
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
        say({"event": "rights", "text": f"its worker is not pinned to CPU {cpu}: it does not exist or is not allowed"})
    lock_memory(once_touched=True)
    urgent = os.sched_param(priority)
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, urgent)
    except PermissionError:
        say({"event": "rights", "text": "no real-time priority for its worker: samples and voltages may come late"})
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


def _first_line() -> bytes:
    line = b""
    while not line.endswith(b"\n"):
        line += os.read(0, 1 << 16)
    return line


if __name__ == "__main__":
    sys.exit(main())
