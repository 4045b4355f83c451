"""What a worker tells the host: what happens, and now and then what it has counted."""

from __future__ import annotations

import json
import os
import time
from collections.abc import Mapping
from typing import Any

_EVERY_NS = 500_000_000
_COUNTERS = ("received", "lost", "performed", "held", "errors", "refused", "links", "skipped")


class Report:
    """The worker's own counters, and when they are due to be told."""

    def __init__(self) -> None:
        self.counts = dict.fromkeys(_COUNTERS, 0)
        self._told_ns = 0

    @property
    def due_ns(self) -> int:
        """When they are to be told next."""
        return self._told_ns + _EVERY_NS

    def tell_counts(self, now_ns: int, of_driver: Mapping[str, int]) -> None:
        """The worker's and the driver's counters, and what of a CPU was used.

        A name that both have is the worker's: `lost`, in samples of all inputs as `received` is, not in frames.
        """
        self._told_ns = now_ns
        counts = {**of_driver, **self.counts}
        say({"event": "statistics", "counts": counts, "cpu_s": round(time.process_time(), 3)})


def tell(event: str, text: str, **more: Any) -> None:
    """Something has happened."""
    say({"event": event, "text": text, **more})


def say(document: dict[str, Any]) -> None:
    """Tell the host, a JSON document a line."""
    try:
        os.write(1, json.dumps(document).encode() + b"\n")
    except (BlockingIOError, BrokenPipeError):
        return  # nobody listens, or not fast enough: the bus comes first
