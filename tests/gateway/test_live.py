"""A real controller and a real gateway beside it: memory that can't be written, orders that are noted, deaths."""

import json
import mmap
import os
import subprocess
import sys
import urllib.error
from contextlib import suppress

import pytest
from websockets.sync.client import connect

from campaigns.running_controller import PATIENCE_S, Running, until
from micromanip.client import Client
from micromanip.gateway.frames import parsed
from tests.cells import LEISURELY, WAITING, changed
from tests.gateway.running_gateway import RunningGateway

pytestmark = [pytest.mark.live, pytest.mark.xdist_group("loop")]
OPEN_TO_WRITE = "import os, sys; os.close(os.open(f'/proc/self/fd/{sys.argv[1]}', os.O_RDWR))"


@pytest.fixture(scope="module")
def cell(tmp_path_factory):
    running = Running(tmp_path_factory.mktemp("cell"), changed(LEISURELY, *WAITING))
    running.reach("READY")
    yield running
    with suppress(Exception):
        running.end()
    running.kill()
    running.release()


@pytest.fixture(scope="module")
def gateway(cell):
    made = RunningGateway(cell)
    yield made
    made.close()


def test_the_memory_that_is_handed_out_can_only_be_read(cell):
    with Client(cell.socket) as client:
        told, descriptors = client.telemetry()
        assert told["axes"] == ["x"]
        assert client.status()["state"] == "READY", "the connection goes on"
    try:
        for descriptor in descriptors:
            mmap.mmap(descriptor, 0, prot=mmap.PROT_READ).close()
            with pytest.raises(PermissionError):
                mmap.mmap(descriptor, 0, prot=mmap.PROT_READ | mmap.PROT_WRITE)
            with pytest.raises(OSError, match=r"Bad file descriptor|Invalid argument"):
                os.ftruncate(descriptor, 1)
            if os.geteuid() == 0:  # what another user can do with it
                python = [
                    "setpriv",
                    "--reuid=65534",
                    "--regid=65534",
                    "--clear-groups",
                    sys.executable,
                    "-c",
                    OPEN_TO_WRITE,
                ]
                done = subprocess.run(
                    [*python, str(descriptor)], pass_fds=[descriptor], capture_output=True, text=True, check=False
                )
                assert "PermissionError" in done.stderr
    finally:
        for descriptor in descriptors:
            os.close(descriptor)


def test_an_order_goes_through_the_socket_and_is_noted_with_the_token(cell, gateway):
    until(lambda: gateway.state() == "READY", "the gateway sees the controller")
    with pytest.raises(urllib.error.HTTPError, match="403"):
        gateway.get("/api/order", "observe", {"order": "arm"})
    gateway.get("/api/order", "operate", {"order": "arm"})
    until(lambda: gateway.state() == "TRACKING", "armed")
    with Client(cell.socket) as client:
        entry = client.log()["entries"][-1]
    assert (entry["verb"], entry["accepted"]) == ("arm", True)
    assert entry["user"].endswith(" for operator")
    assert entry["pid"] == gateway.process.pid


def test_the_ring_is_followed_without_gaps_over_a_websocket(gateway):
    seen, lost = [], None
    with connect(f"ws://{gateway.host}/live", max_size=None) as browser:
        browser.send(json.dumps({"type": "hello", "token": gateway.secret["observe"]}))
        view = {"type": "view", "fields": ["x.strain_um", "x.voltage_V"], "span_s": 2.0, "points": 800, "last": None}
        while len(seen) < 20:
            message = browser.recv(PATIENCE_S)
            if isinstance(message, str):
                if json.loads(message)["type"] == "hello":
                    browser.send(json.dumps(view))
                else:
                    browser.send('{"type": "drawn"}')
                continue
            header, arrays = parsed(message)
            seen.append(header["newest"])
            lost = header["lost"]
            assert len(arrays["x.strain_um low"]) == len(arrays["cycles"])
            browser.send('{"type": "drawn"}')
    assert seen == sorted(set(seen))
    assert lost == 0
    assert "micromanip_up 1.0" in gateway.get("/metrics", "observe")


def test_it_is_handed_out_again_and_again_without_a_leak(cell):
    with Client(cell.socket) as client:
        client.status()
        before = cell.descriptors
        for _ in range(50):
            for descriptor in client.telemetry()[1]:
                os.close(descriptor)
        until(lambda: cell.descriptors <= before + 1, "descriptors of the host are left open")
