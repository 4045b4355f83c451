"""``python -m tools.watched_soak [MINUTES]``: a cell at 10 kHz, recorded in full, watched by everything that can watch.

Three browsers' connections on the scope and a fourth that is frozen, metrics fetched each second, two hundred nodes of
OPC UA subscribed, and a `set` each second; every half minute the gateway is stopped for five seconds (SIGSTOP) and
nothing else is asked: the loop's rows of both are compared. Ends with 1 where a gap, a loss or a growth is.
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
import sys
import tempfile
import threading
import time
import urllib.request
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
from asyncua import Client as UaClient
from asyncua import ua
from numpy.typing import NDArray
from scipy.stats import binom
from websockets.sync.client import connect

from micromanip.bus.rights import leave_cpu
from micromanip.client import Client
from micromanip.errors import DeviceUnavailable
from micromanip.gateway.frames import parsed
from micromanip.recordings import open_telemetry
from micromanip.settings.check import prepare
from micromanip.status_reply import Status
from tools.running_controller import MICROMANIP, reset, until

CONFIG = Path(__file__).parents[1] / "config" / "simulated.yaml"
WATCHED_S, STOPPED_S, SETTLING_S = 25.0, 5.0, 2.0
NODES, BROWSERS = 200, 3
_STALL_CYCLES, _STALLED = 4000, 0.1
FIELDS = ["x.setpoint_um", "x.strain_um", "x.voltage_V", "y.path_error_um", "z.path_error_um", "lateness_ns"]
Array = NDArray[np.int64] | NDArray[np.bool_]
_HOST, _OPCUA = "127.0.0.1:18190", "127.0.0.1:18191"


def serves() -> bool:
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

    def __init__(self, folder: Path, token: str, socket: Path) -> None:
        self.frames, self.problems = [0] * BROWSERS, []
        self.fetched = self.changed = self.sets = 0
        self._folder, self._token, self._socket = folder, token, socket
        self.trips: list[str] = []
        self._over, self.awake = threading.Event(), threading.Event()
        work = [
            *([self._browse, k] for k in range(BROWSERS)),
            [self._freeze],
            [self._fetch],
            [self._set],
            [self._subscribe],
        ]
        self._threads = [threading.Thread(target=self._noted, args=each, daemon=True) for each in work]
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
        except Exception as problem:  # whatever it is, it is told at the end
            self.problems.append(f"{work.__name__}: {type(problem).__name__}: {problem}")

    @contextlib.contextmanager
    def _greeted(self, seconds: float) -> Any:
        with connect(f"ws://{_HOST}/live", max_size=None, open_timeout=60, origin=f"http://{_HOST}") as browser:  # type: ignore[arg-type]
            browser.send(json.dumps({"type": "hello", "token": self._token}))
            view = {"type": "view", "fields": FIELDS, "span_s": seconds, "points": 1200, "last": None}
            browser.recv()  # its hello: before that there is no cell to look at
            browser.send(json.dumps(view))
            yield browser

    def _browse(self, which: int) -> None:
        with self._greeted((0.2, 2.0, 30.0)[which]) as browser:
            number = 0
            while not self._over.is_set():
                try:
                    message = browser.recv(timeout=1.0)
                except TimeoutError:
                    continue
                if isinstance(message, bytes):
                    header, _ = parsed(message)
                    if header["number"] != number + 1:
                        self.problems.append(f"browser {which}: frame {header['number']} after {number}")
                    if header["lost"]:
                        self.problems.append(
                            f"browser {which}: {header['lost']} rows lost before the gateway read them"
                        )
                        return
                    number = header["number"]
                    self.frames[which] += 1
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
        for _ in self._seconds():
            request = urllib.request.Request(
                f"http://{_HOST}/metrics", headers={"authorization": f"Bearer {self._token}"}
            )
            with urllib.request.urlopen(request, timeout=60) as answer:
                self.fetched += b"micromanip_up 1" in answer.read()

    def _set(self) -> None:
        with Client(self._socket) as client:
            value = client.value("axes.x.inner.Ti_ms")
            for _, share in zip(self._seconds(), itertools.cycle((1.01, 1.0)), strict=False):
                if (status := client.status())["state"] == "FAULT":
                    self._arm_again(client, status)
                elif status["state"] == "TRACKING":
                    client.set({"axes.x.inner.Ti_ms": round(value * share, 6)})
                    self.sets += 1

    def _arm_again(self, client: Client, status: Status) -> None:
        """A machine that stalls for too long trips the cell: it is told at the end, and the cell armed again."""
        self.trips += [f"{fault['seen']}, cycle {fault['cycle']}" for fault in status["fault_reports"]]
        reset(client)
        client.arm()

    def _subscribe(self) -> None:
        asyncio.run(self._subscribed())

    async def _subscribed(self) -> None:
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
        self.changed += 1


def resources(process: int) -> tuple[int, int]:
    """Resident kB and open descriptors."""
    status = Path(f"/proc/{process}/status").read_text()
    resident = next(line.split()[1] for line in status.splitlines() if line.startswith("VmRSS"))
    return int(resident), len(list(Path(f"/proc/{process}/fd").iterdir()))


def tracks(socket: Path) -> bool:
    """Whether a controller answers on `socket`, and tracks."""
    try:
        with Client(socket) as client:
            return client.status()["state"] == "TRACKING"
    except DeviceUnavailable:
        return False


def main(minutes: float) -> int:
    """0 where there is no gap, no loss and no growth."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        socket, file = folder / "control.sock", folder / "soak.mcap"
        run = [str(MICROMANIP), "run", str(CONFIG), "--socket", str(socket), "--record", str(file), "--json"]
        gateway = [
            str(MICROMANIP),
            "gateway",
            str(CONFIG),
            "--socket",
            str(socket),
            "--listen",
            _HOST,
            "--opcua",
            _OPCUA,
        ]
        gateway += ["--tokens", str(folder / "tokens"), "--opcua-folder", str(folder / "opcua")]
        seconds = minutes * 60
        controller = subprocess.Popen([*run, "--duration", str(seconds + 100)], stdout=subprocess.PIPE, text=True)
        beside = subprocess.Popen(gateway)
        stopped: list[tuple[int, int]] = []
        try:
            leave_cpu(prepare(CONFIG).configuration.loop.cpu)  # who watches sits elsewhere
            until(lambda: tracks(socket), "it tracks")
            until(serves, "the gateway serves")
            token = next(
                line.split()[2]
                for line in (folder / "tokens").read_text().splitlines()
                if "observe" in line and line[0] != "#"
            )
            watchers = Watchers(folder, token, socket)
            watchers.awake.set()
            begun_ns, before, end_s = time.monotonic_ns(), None, time.monotonic() + seconds
            while time.monotonic() < end_s:
                time.sleep(WATCHED_S)
                if before is None:
                    before = [resources(process) for process in (controller.pid, beside.pid)]
                watchers.awake.clear()
                time.sleep(0.5)
                os.kill(beside.pid, signal.SIGSTOP)
                at_ns = time.monotonic_ns()
                time.sleep(STOPPED_S)
                stopped.append((at_ns, time.monotonic_ns()))
                os.kill(beside.pid, signal.SIGCONT)
                watchers.awake.set()
                left_s = end_s - time.monotonic()
                print(f"{max(left_s, 0) / 60:.1f} min left; frames {watchers.frames}, metrics {watchers.fetched}, "
                      f"changes by OPC UA {watchers.changed}, sets {watchers.sets}", flush=True)  # fmt: skip
            after = [resources(process) for process in (controller.pid, beside.pid)]
            watchers.end()
        finally:
            beside.terminate()
            controller.terminate()
            report = json.loads(controller.communicate()[0])
            beside.wait()
        return judged(report, file, begun_ns, stopped, watchers, before or after, after)


def turn_by_turn(values: Array, at: Array, watched: Array, turns: Iterable[tuple[int, tuple[int, int]]]) -> str:
    """Median of the ratios of the turns, each with the pause behind it, and its 95 % interval by order statistics.

    A machine that stalls makes the tail of some turns; it does not choose which of the two it meets.
    """
    ratios = []
    for begun_ns, (first, last) in turns:
        one, other = (values[watched & (at >= begun_ns) & (at < first)], values[(at > first) & (at < last)])
        if len(one) and len(other):
            ratios.append(np.percentile(one, 99.9) / np.percentile(other, 99.9))
    ratios.sort()
    low = max(0, int(binom.ppf(0.025, len(ratios), 0.5)) - 1)
    return f"median {np.median(ratios):.3f}, {ratios[low]:.3f} to {ratios[-1 - low]:.3f}, {len(ratios)} turns"


def judged(
    report: Any, file: Path, begun_ns: int, stopped: list[tuple[int, int]], watchers: Watchers, before: Any, after: Any
) -> int:
    """Print all findings; 1 where one is bad."""
    problems = list(watchers.problems)
    telemetry = open_telemetry(file)
    columns = {path: telemetry.column(path) for path in ("cycle", "periods", "time_ns", "lateness_ns", "compute_ns")}
    gaps = int((np.diff(columns["cycle"]) != columns["periods"][1:]).sum())
    if gaps or telemetry.end.get("lost") or not telemetry.end:
        problems.append(f"recording: {gaps} gaps, {telemetry.end}")
    if report["faults"] or report["state"] != "OFF":
        problems.append(f"the controller: {report['state']}, {report['faults']}")
    at = columns["time_ns"]
    apart = np.zeros(len(at), bool)
    unclear = at < begun_ns
    for first, last in stopped:
        apart |= (at > first) & (at < last)
        unclear |= (at >= last) & (at < last + int(SETTLING_S * 1e9))
    watched = ~apart & ~unclear & (at < stopped[-1][1])
    print(f"{len(at)} rows recorded, {int(watched.sum())} watched, {int(apart.sum())} with the gateway stopped")
    for name in ("compute_ns", "lateness_ns"):
        with_it, without = (np.percentile(columns[name][rows], (50, 99, 99.9)) / 1e3 for rows in (watched, apart))
        ratios = ", ".join(
            f"{one:.2f} / {other:.2f} = {one / max(other, 1e-3):.3f}"
            for one, other in zip(with_it, without, strict=True)
        )
        print(f"{name[:-3]}, us, p50, p99, p99.9, watched / alone: {ratios}")
        turns = zip([begun_ns, *(last for _, last in stopped[:-1])], stopped, strict=True)
        print(f"{'':8}p99.9 turn by turn: {turn_by_turn(columns[name], at, watched, turns)}")
    for name, (kB, files), (kB_at_end, files_at_end) in zip(("host", "gateway"), before, after, strict=True):
        print(f"{name}: {kB / 1e3:.0f} MB, {files} descriptors; at the end {kB_at_end / 1e3:.0f} MB, {files_at_end}")
        if files_at_end > files + 2:
            problems.append(f"{name}: descriptors grow from {files} to {files_at_end}")
    if min(watchers.frames) == 0 or watchers.fetched == 0 or watchers.changed < NODES or watchers.sets == 0:
        problems.append("somebody saw nothing")
    for trip in watchers.trips:
        at = int(trip.rpartition(" ")[2])
        before = (columns["cycle"] > at - _STALL_CYCLES) & (columns["cycle"] <= at)
        missed = 1.0 - int(before.sum()) / _STALL_CYCLES
        print(f"TRIP: {trip}; {100 * missed:.0f} % of the {_STALL_CYCLES} cycles before were missed")
        if missed < _STALLED:
            problems.append(f"a trip that no stall of the machine explains: {trip}")
    for problem in problems:
        print(f"PROBLEM: {problem}")
    return 1 if problems else 0


if __name__ == "__main__":
    sys.exit(main(float(sys.argv[1]) if len(sys.argv) > 1 else 10.0))
