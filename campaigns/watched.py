"""A cell at 10 kHz, recorded in full, watched by everything that can watch: nothing is lost, nothing grows.

Three browsers on the scope and a fourth that is frozen, metrics and a `set` each second, two hundred nodes of OPC UA;
every half minute the gateway is stopped for five seconds (SIGSTOP). Wrong is a gap, a loss, a growth, and a trip that
no stall of the machine explains.
"""

from __future__ import annotations

import asyncio
import contextlib
import itertools
import json
import os
import signal
import socket as connection
import subprocess
import threading
import time
import urllib.request
from pathlib import Path
from typing import Any

import numpy as np
from asyncua import Client as UaClient
from asyncua import ua
from websockets.sync.client import connect

from micromanip.bus.rights import leave_cpu
from micromanip.client import Client
from micromanip.errors import DeviceUnavailable
from micromanip.gateway.frames import parsed
from micromanip.recordings import open_telemetry
from micromanip.settings.check import prepare

from .report import ROOT, Asked, Report
from .running_controller import MICROMANIP, reset, until

CONFIG = ROOT / "config" / "simulated.yaml"
WATCHED_S, STOPPED_S = 25.0, 5.0
NODES, SPANS_S = 200, (0.2, 2.0, 30.0)
"""Of OPC UA; what each browser looks at."""
FIELDS = ["x.setpoint_um", "x.strain_um", "x.voltage_V", "y.path_error_um", "z.path_error_um", "lateness_ns"]
_STALL_CYCLES, _STALLED = 4000, 0.1
"""A trip is the machine's doing where this share of so many cycles before it was missed."""
_HOST, _OPCUA = "127.0.0.1:18190", "127.0.0.1:18191"


def _serves() -> bool:
    """Whether pages and OPC UA of the gateway can be reached; its tokens are there by then."""
    for place in (_HOST, _OPCUA):
        host, port = place.split(":")
        try:
            connection.create_connection((host, int(port)), 1.0).close()
        except OSError:
            return False
    return True


class Watchers:
    """Everything that watches, each in a thread; what each has seen is counted."""

    def __init__(self, token: str, socket: Path) -> None:
        self.seen = {"metrics": 0, "OPC UA": 0, "set": 0, **{f"browser {k}": 0 for k in range(len(SPANS_S))}}
        self.problems: list[str] = []
        self.trips: list[int] = []
        """Their cycles."""
        self.awake = threading.Event()
        self._token, self._socket, self._over = token, socket, threading.Event()
        work = [*((self._browse, k) for k in range(len(SPANS_S))), (self._freeze,), (self._fetch,), (self._set,)]
        work.append((lambda: asyncio.run(self._subscribe()),))
        self._threads = [threading.Thread(target=self._noted, args=each, daemon=True) for each in work]
        self.awake.set()
        for thread in self._threads:
            thread.start()

    def end(self) -> None:
        """Let them go."""
        self.awake.set()
        self._over.set()
        for thread in self._threads:
            thread.join(30)

    def _noted(self, work: Any, *arguments: Any) -> None:
        try:
            work(*arguments)
        except Exception as problem:  # whatever it is, it stands in the report
            self.problems.append(f"{type(problem).__name__}: {problem}")

    @contextlib.contextmanager
    def _greeted(self, seconds: float) -> Any:
        with connect(f"ws://{_HOST}/live", max_size=None, open_timeout=60, origin=f"http://{_HOST}") as browser:
            browser.send(json.dumps({"type": "hello", "token": self._token}))
            browser.recv()  # its hello: before that there is no cell to look at
            browser.send(
                json.dumps({"type": "view", "fields": FIELDS, "span_s": seconds, "points": 1200, "last": None})
            )
            yield browser

    def _browse(self, which: int) -> None:
        with self._greeted(SPANS_S[which]) as browser:
            number = 0
            while not self._over.is_set():
                try:
                    message = browser.recv(timeout=1.0)
                except TimeoutError:
                    continue
                if isinstance(message, bytes):
                    header, _ = parsed(message)
                    if header["number"] != number + 1 or header["lost"]:
                        lost = f"{header['lost']} rows lost before"
                        self.problems.append(f"browser {which}: frame {header['number']} after {number}, {lost}")
                        return
                    number = header["number"]
                    self.seen[f"browser {which}"] += 1
                if isinstance(message, bytes) or json.loads(message)["type"] == "status":
                    browser.send(json.dumps({"type": "drawn"}))

    def _freeze(self) -> None:
        with self._greeted(2.0):
            self._over.wait()

    def _seconds(self) -> Any:
        while not self._over.wait(1.0):
            self.awake.wait()
            yield

    def _fetch(self) -> None:
        headers = {"authorization": f"Bearer {self._token}"}
        for _ in self._seconds():
            request = urllib.request.Request(f"http://{_HOST}/metrics", headers=headers)
            with urllib.request.urlopen(request, timeout=60) as answer:
                self.seen["metrics"] += b"micromanip_up 1" in answer.read()

    def _set(self) -> None:
        with Client(self._socket) as client:
            value = client.value("axes.x.inner.Ti_ms")
            for _, share in zip(self._seconds(), itertools.cycle((1.01, 1.0)), strict=False):
                if (status := client.status())["state"] == "FAULT":  # a machine that stalls for too long
                    self.trips += [fault["cycle"] for fault in status["fault_reports"]]
                    reset(client)
                    client.arm()
                elif status["state"] == "TRACKING":
                    client.set({"axes.x.inner.Ti_ms": round(value * share, 6)})
                    self.seen["set"] += 1

    async def _subscribe(self) -> None:
        async with UaClient(f"opc.tcp://{_OPCUA}/micromanip", timeout=60, watchdog_intervall=60) as client:
            index = await client.get_namespace_index("urn:micromanip:cell")
            found, place = [], [client.get_node(ua.NodeId("cell", index))]
            while place and len(found) < NODES:
                for below in await place.pop().get_children():
                    kind = await below.read_node_class()
                    if kind == ua.NodeClass.Variable:
                        found.append(below)
                    elif kind == ua.NodeClass.Object:
                        place.append(below)
            subscription = await client.create_subscription(500, self)
            await subscription.subscribe_data_change(found[:NODES])
            while not self._over.is_set():
                await asyncio.sleep(0.2)

    def datachange_notification(self, *_: Any) -> None:
        """As asyncua calls it."""
        self.seen["OPC UA"] += 1


def _tracks(socket: Path) -> bool:
    try:
        with Client(socket) as client:
            return client.status()["state"] == "TRACKING"
    except DeviceUnavailable:
        return False


def _descriptors(process: int) -> int:
    return len(list(Path(f"/proc/{process}/fd").iterdir()))


def run(asked: Asked) -> Report:
    """`count` minutes."""
    folder, seconds = asked.folder, asked.count * 60.0
    socket, file, tokens = folder / "control.sock", folder / "soak.mcap", folder / "tokens"
    run = [
        MICROMANIP,
        "run",
        CONFIG,
        "--socket",
        socket,
        "--record",
        file,
        "--json",
        "--duration",
        f"{seconds + 100:g}",
    ]
    gateway = [MICROMANIP, "gateway", CONFIG, "--socket", socket, "--listen", _HOST, "--opcua", _OPCUA]
    gateway += ["--tokens", tokens, "--opcua-folder", folder / "opcua"]
    controller = subprocess.Popen(run, stdout=subprocess.PIPE, text=True)
    beside = subprocess.Popen(gateway)
    processes = {"host": controller.pid, "gateway": beside.pid}
    try:
        leave_cpu(prepare(CONFIG).configuration.loop.cpu)  # who watches sits elsewhere
        until(lambda: _tracks(socket), "it tracks")
        until(_serves, "the gateway serves")
        lines = [line.split() for line in tokens.read_text().splitlines() if not line.startswith("#")]
        watchers = Watchers({scope: token for _, scope, token in lines}["observe"], socket)
        before, end_s = {}, time.monotonic() + seconds
        while time.monotonic() < end_s:
            time.sleep(WATCHED_S)
            before = before or {name: _descriptors(pid) for name, pid in processes.items()}
            watchers.awake.clear()
            os.kill(beside.pid, signal.SIGSTOP)
            time.sleep(STOPPED_S)
            os.kill(beside.pid, signal.SIGCONT)
            watchers.awake.set()
            asked.tell(f"{max(end_s - time.monotonic(), 0) / 60:.1f} min left; {watchers.seen}")
        grown = {name: _descriptors(pid) - before[name] for name, pid in processes.items()}
        watchers.end()
    finally:
        beside.terminate()
        controller.terminate()
        ended = json.loads(controller.communicate()[0])
        beside.wait()
    return _judged(ended, file, watchers, grown)


def _judged(ended: Any, file: Path, watchers: Watchers, grown: dict[str, int]) -> Report:
    wrong = list(watchers.problems)
    telemetry = open_telemetry(file)
    cycle, periods = telemetry.column("cycle"), telemetry.column("periods")
    gaps = int((np.diff(cycle) != periods[1:]).sum())
    if gaps or telemetry.end.get("lost") or not telemetry.end.get("complete"):
        wrong.append(f"the recording: {gaps} gaps, {telemetry.end}")
    if ended["faults"] or ended["state"] != "OFF":
        wrong.append(f"the controller: {ended['state']}, {ended['faults']}")
    wrong += [f"{name}: {more} descriptors more" for name, more in grown.items() if more > 2]
    wrong += [f"{who} saw nothing" for who, count in watchers.seen.items() if not count]
    for at in watchers.trips:
        missed = 1.0 - int(((cycle > at - _STALL_CYCLES) & (cycle <= at)).sum()) / _STALL_CYCLES
        if missed < _STALLED:
            wrong.append(f"a trip in cycle {at} that no stall of the machine explains")
    rows = [{"who": who, "messages": count} for who, count in watchers.seen.items()]
    lateness = np.percentile(telemetry.column("lateness_ns"), (50, 99, 99.9)) / 1e3
    late = ", ".join(f"{us:.0f}" for us in lateness)
    notes = [f"{len(cycle)} rows recorded, {gaps} gaps; the loop was late by {late} us (p50, p99, p99.9)"]
    notes.append(f"{len(watchers.trips)} trips by stalls of the machine")
    return Report({"seen": rows}, notes, wrong)
