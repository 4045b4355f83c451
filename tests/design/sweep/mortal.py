"""Trials that cost nothing, and kill their worker where they are told to; workers import little with them."""

import os
import random
import signal
from dataclasses import dataclass
from pathlib import Path

from micromanip.design.sweep.work import Tried


def tried(number):
    """What the tuning of that number gives; some stop, some are refused."""
    values = {"a.b": float(number), "c": 1.0 / (number + 1)} if number else {}
    if number % 7 == 3:
        return Tried(number, values, stopped=1)
    if number % 11 == 5:
        return Tried(number, values, problem="too much")
    error = random.Random(number).random()
    return Tried(number, values, error, (error, 1.0), (2.0, 3.0), (4.0, 5.0))


@dataclass(frozen=True)
class Mortal:
    """Trials whose worker is killed, once per file that is there, as it comes to a tuning of that number."""

    folder: Path

    def tried(self, number):
        fatal = self.folder / str(number)
        if fatal.exists():
            fatal.unlink()
            os.kill(os.getpid(), signal.SIGKILL)
        return tried(number)
