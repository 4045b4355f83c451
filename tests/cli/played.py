"""A controller that is played: a control socket that answers as it is told."""

import contextlib
import json
import socket
import threading

TIMES = {"p50": 1000, "p99": 2000, "p99_9": 3000, "p99_99": 4000, "max": 5000}
FAULT = {
    "code": "X-201",
    "name": "STRAIN_INVALID",
    "axis": "x",
    "driver": None,
    "value": 3.0,
    "limit": None,
    "cycle": 7,
    "seen": "X-201 axis x: no usable strain-gauge sample for 3 cycles",
    "likely_causes": ["a cable"],
    "next_step": "Look at the gauge's plug.",
}


def value(latest, unknown=None):
    window = None
    if latest is not None:
        window = {"seconds": 1.0, "mean": latest, "min": latest, "max": latest, "rms": 0.5, "peak": 1.25}
        window |= {"deviation_rms": 0.125, "deviation_peak": 0.375}
    return {"latest": latest, "unknown": unknown, "second": window, "minute": window}


def status(state="TRACKING", faults=(), position=(51.25, None)):
    axis = {
        "position_um": value(*position),
        "setpoint_um": value(66.5),
        "strain_um": value(66.0),
        "voltage_V": value(100.0),
        "headroom_V": value(50.0),
        "error_um": value(-0.25),
        "error_of": "path",
        "tooth_Hz": 199.5,
        "joints_Hz": [8.25, None],
        "untuned": False,
        "less": None,
        "swing": None,
    }
    return {
        "state": state,
        "cycles": 50_000,
        "overruns": 3,
        "period_ns": 100_000,
        "lateness_ns": TIMES,
        "compute_ns": TIMES,
        "path_error_um": {},
        "axes": {"x": axis, "y": axis},
        "faults": [fault["seen"] for fault in faults],
        "fault_reports": list(faults),
        "slow_signals": [],
        "learning": None,
        "recording": None,
        "candidate": "none",
        "links": {},
        "signals": {},
        "parameter_version": 3,
        "configuration": "cell.yaml",
    }


class Played:
    """A control socket that answers as it is told, and remembers what it was asked to do."""

    def __init__(self, path):
        self.path, self.status, self.orders, self.refuses = path, status(), [], None
        self._connections = []
        self.open()

    def open(self):
        self._listener = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        self._listener.bind(str(self.path))
        self._listener.listen()
        threading.Thread(target=self._accept, args=(self._listener,), daemon=True).start()

    def close(self):
        self.path.unlink(missing_ok=True)
        for each in (self._listener, *self._connections):
            with contextlib.suppress(OSError):
                each.shutdown(socket.SHUT_RDWR)
            each.close()
        self._connections = []

    def _accept(self, listener):
        with contextlib.suppress(OSError):
            while True:
                connection, _ = listener.accept()
                self._connections.append(connection)
                threading.Thread(target=self._serve, args=(connection,), daemon=True).start()

    def _serve(self, connection):
        with contextlib.suppress(OSError, ValueError), connection.makefile("rb") as lines:
            for line in lines:
                connection.sendall(json.dumps(self._answer(json.loads(line)["verb"])).encode() + b"\n")

    def _answer(self, verb):
        if verb == "status":
            return {"version": 1, "ok": True, "result": self.status}
        self.orders.append(verb)
        if self.refuses is not None:
            return {"version": 1, "ok": False, "error": self.refuses, "exit_code": 1}
        return {"version": 1, "ok": True, "result": None}
