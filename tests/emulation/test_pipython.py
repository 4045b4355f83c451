"""The maker's own client for GCS controllers, PIPython, talks to the simulated one over TCP: both agree."""

import threading
import time

import pytest

from campaigns.fault_cells import free_port
from micromanip.emulation.devices import Devices

from .lines import GCS, write_cell

pipython = pytest.importorskip("pipython", reason="PIPython is not installed: pip install PIPython")


@pytest.fixture
def devices(tmp_path):
    port = free_port()
    devices = Devices(write_cell(tmp_path, GCS.format(port=f"tcp: {{host: 127.0.0.1, port: {port}}}")), watchdog_ms=1e9)
    devices.port = port
    devices.start()
    thread = threading.Thread(target=devices.loop.run)
    thread.start()
    yield devices
    devices.loop.stop()
    thread.join()
    devices.close()


@pytest.fixture
def client(devices):
    from pipython.pidevice.interfaces.pisocket import PISocket

    class Link(PISocket):
        """Its owner closes it when it is done, and again when it is thrown away."""

        def close(self):
            if self.connected:
                super().close()

    with pipython.GCSDevice(gateway=Link("127.0.0.1", devices.port)) as client:
        yield client


def test_it_recognises_controller_axes_and_commands(client):
    assert "E-727" in client.qIDN()
    assert client.devname == "E-727"
    assert client.axes == ["1", "2"]
    assert client.HasqPOS()
    assert client.HasSVA()
    assert not client.HasqFRF()


def test_what_it_writes_arrives_and_what_it_reads_is_there(client, devices):
    client.SVA({"1": 12.5, "2": -3.0})
    assert client.qSVA() == {"1": 12.5, "2": -3.0}
    assert client.qVOL() == {1: 12.5, 2: -3.0}
    assert client.qVOL(1) == {1: 12.5}
    assert devices.cell.voltages() == {"voltage_x": 12.5, "voltage_y": -3.0}
    patience_s = time.monotonic() + 20.0
    while abs(client.qPOS("1")["1"] - devices.cell.plant.value("strain_x")) >= 1.0:  # it moves between the two looks
        assert time.monotonic() < patience_s
    assert list(client.qTSP()) == [1, 2]
