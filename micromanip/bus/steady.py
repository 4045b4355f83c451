"""The compiled turns that stand in for a worker's (``rt/io/worker_loop.py``), given what they need."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from micromanip.rt.io.worker_records import INBOX, LEFT_OVER, MEMORY, SERVICE
from micromanip.rt.jit import PLAIN, prepare

from .driver import BusDriver, Steady
from .image import ProcessImage
from .last_given import LastGiven
from .safe_state import SafeState
from .schedule import Schedule

_NOTHING = np.zeros(1, MEMORY)
_NOTHING["file"] = -1


class SteadyService:
    """The compiled turns of one worker."""

    def __init__(self, steady: Steady, image: ProcessImage) -> None:
        """Loads them, or compiles them where that was not done before."""
        from micromanip.rt.io import worker_loop  # compiled: loaded only where it is going to be called

        self._serve: Callable[..., int] = worker_loop.serve
        self._image, self._fileno = image, steady.fileno
        self._service, self._inbox = np.zeros(1, SERVICE), np.zeros(1, INBOX)
        self._context = steady.context  # what it points to must stay where it is
        st = self._service[0]
        st["receive"], st["send"], st["context"] = steady.receive, steady.send, steady.context.ctypes.data
        prepare(worker_loop.serve)

    @classmethod
    def of(cls, driver: BusDriver, image: ProcessImage) -> SteadyService | None:
        """For a driver that has the two functions; None for others."""
        steady = None if PLAIN else driver.steady()
        return None if steady is None else cls(steady, image)

    def ask_back(self) -> None:
        """Let the compiled turns end; may be called from another thread."""
        self._service[0]["leave"][0] = 1

    def begin(self) -> None:
        """Forget that it was asked back; what was asked of Python before this must be looked at after it."""
        self._service[0]["leave"][0] = 0

    def serve(
        self, safe: SafeState, schedule: Schedule, memory: LastGiven | None, look_ns: int, until_ns: int
    ) -> tuple[dict[str, int], bool]:
        """Serve until Python is needed, and until `until_ns` at the latest.

        The link must be open, and the outputs not on a ramp. They go on in the records of `safe` and `schedule`.
        What that came to, and whether what came, or did not, is left to the driver's `receive`.
        """
        st, inbox, image = self._service[0], self._inbox[0], self._image.record
        st["descriptor"], st["look_ns"], st["until_ns"] = self._fileno(), look_ns, until_ns
        st["calls"] = st["performed"] = inbox["received"] = inbox["lost"] = inbox["confirmed"] = 0
        inbox["signal"]["sequence"], inbox["missing"] = image[0]["input"]["sequence"], image[0]["missing"]
        remembered = _NOTHING if memory is None else memory.record
        code = self._serve(self._service, safe.record, schedule.record, image, self._inbox, remembered)
        places = {"calls": st, "performed": st, "received": inbox, "lost": inbox}
        return {name: int(place[name]) for name, place in places.items()}, code == LEFT_OVER
