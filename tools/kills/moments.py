"""Moments at which a process of a controller may die: each brings a cell that waits in READY there."""

import contextlib
import threading
import time

from micromanip.client import Client
from micromanip.errors import CheckFailed, DeviceUnavailable
from micromanip.rt import mailbox as w
from micromanip.rt.states import STAGE_CHECK, STRAIN_CHECK
from tools.running_controller import until

GAIN = "axes.x.inner.K_V_per_um"
FOLLOWING = {f"faults.axis.following_error.{key}": value for key, value in (("limit_um", 1e-6), ("time_ms", 0.1))}
STRAIN = {"faults.axis.strain.rate_um_per_ms": 1e-6}
_STATE = {"arming": "TRACKING", "tracking": "TRACKING", "set": "TRACKING"}
_STATE |= {"holding": "HOLDING", "ramping": "READY", "trip": "FAULT"}
_TRIALS = 5
WEIGHTS = {"arming": 4, "tracking": 5, "set": 3, "holding": 2, "ramping": 3, "trip": 3}
"""How often each comes, in shares."""


class Moment:
    """One such moment: `name` says which, `random` (random.Random) when exactly.

    ``with Moment(cell, name, random):`` the body runs at that moment, the traffic of the moment ends with it.
    """

    def __init__(self, cell, name, random):
        self._cell, self._random = cell, random
        self.name, self.leads_to = name, _STATE[name]
        self._changing = None
        self._over = threading.Event()
        self._limits = {}
        self.spoilt = 0
        """Checks that failed before: on a busy machine a stalled loop moves late."""

    def __enter__(self):
        with Client(self._cell.socket) as client:
            client.arm()
            if self.name == "arming":
                phases = ("lift_cycles", "sweep_cycles", "settle_cycles", "authority_cycles")
                until(lambda: self._cell.state != "READY", "the loop has begun to arm")
                self._wait(self._seconds(*phases, checks=self._checks()))
                return self
            self._track(client)
            getattr(self, f"_{self.name}")(client)
        return self

    def _track(self, client):
        """Wait for TRACKING; a check that a stall of the machine has spoilt is tried again."""
        for _ in range(_TRIALS):
            until(
                lambda: self._cell.state in ("TRACKING", "FAULT"), lambda: f"TRACKING, it is {self._cell.state}", 20.0
            )
            if self._cell.state == "TRACKING":
                return
            assert self._cell.status["words"][w.FAULT_CODE] in (STRAIN_CHECK, STAGE_CHECK), self._cell.said
            self.spoilt += 1
            until(lambda: _accepted(client.reset), "the reset", 20.0)
            client.arm()
        raise AssertionError(f"its check failed {_TRIALS} times; {self._cell.said}")

    def __exit__(self, *_):
        self._over.set()
        if self._changing is not None:
            self._changing.join()

    def undo(self):
        """Bring a controller that lives on back to READY, with the limits that it had."""
        with Client(self._cell.socket) as client:
            if self._limits:
                client.set(self._limits)
            if self.leads_to == "FAULT":
                until(lambda: _accepted(client.reset), "the reset")
            elif self.leads_to != "READY":
                client.disarm()
        self._cell.reach("READY")

    def _checks(self):
        """How many checks this arming has."""
        state = self._cell.status["state"][0]
        return int(state["probes"] + state["bumps"])

    def _seconds(self, *phases, checks=0):
        p = self._cell.control["parameters"][0]
        cycles = sum(p[name] for name in phases) + checks * p["check_cycles"]
        return float(cycles * p["period_ns"] * 1e-9)

    def _wait(self, most_s):
        time.sleep(self._random.uniform(0.0, most_s))

    def _tracking(self, client):
        self._wait(1.0)

    def _holding(self, client):
        client.hold()
        self._wait(0.3)

    def _ramping(self, client):
        client.disarm()
        self._wait(self._seconds("authority_cycles", "ramp_cycles"))

    def _set(self, client):
        """One swap after the other: the moment may fall into any step of one."""
        self._changing = threading.Thread(target=self._change)
        self._changing.start()
        self._wait(0.3)

    def _change(self):
        values = 0
        with contextlib.suppress(CheckFailed, DeviceUnavailable), Client(self._cell.socket) as client:
            while not self._over.is_set():
                values += 1
                client.set({GAIN: 0.6 - 0.01 * (values % 10)})

    def _trip(self, client):
        """From the cycle of the trip to some time after its black box should be complete."""
        limits = self._random.choice((FOLLOWING, STRAIN))
        self._limits = {key: client.value(key) for key in limits}
        before = self._cell.status["words"][w.TRIPS]
        client.set(limits)
        until(lambda: self._cell.status["words"][w.TRIPS] > before, "a trip")
        self._wait(1.0)


def _accepted(command):
    with contextlib.suppress(CheckFailed):
        command()
        return True
    return False
