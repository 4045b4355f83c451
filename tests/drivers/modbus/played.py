"""The units that `device simulate` plays for a configuration of config/, in a thread of the test."""

import time
from contextlib import contextmanager

import yaml
from testbus.loop_in_thread import LoopInThread

from campaigns.report import CONFIG
from micromanip.emulation.devices import Devices

from ..line.wires import free_port, socket

QUIET = {"strain_noise_nm": 0.0, "strain_hum_nm": 0.0, "stage_noise_nm": 0.0}
PATIENCE_S = 20.0


def document(name):
    with (CONFIG / name).open(encoding="utf-8") as stream:
        return yaml.safe_load(stream)


def keys_of(config):
    """The keys of its driver."""
    return config["drivers"]["modbus"]


class Played:
    """A configuration on a port of its own; `devices` may be asked by `do` only."""

    def __init__(self, folder, name):
        self.config = document(name)
        keys = keys_of(self.config)
        if "tcp" in keys:
            keys["tcp"]["port"] = self.port = free_port(socket.SOCK_STREAM)
        else:
            keys["serial"]["device"] = self.path = str(folder / "tty")
        self.config["simulation"]["plant"] = QUIET
        self.config["simulation"].pop("variation")
        self.file = folder / "cell.yaml"
        self.file.write_text(yaml.safe_dump(self.config, sort_keys=False), encoding="utf-8")
        self.devices = Devices(self.file, watchdog_ms=60_000.0)
        self.devices.start()
        self._running = LoopInThread(self.devices.loop)
        self.do = self._running.ask

    def order(self, line):
        return self.do(lambda: self.devices.command(line))

    def close(self):
        self._running.end()
        self.devices.close()


def until(condition, seconds=PATIENCE_S):
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end, "it never came"
        time.sleep(0.002)


@contextmanager
def played(folder, name="modbus.yaml"):
    it = Played(folder, name)
    try:
        yield it
    finally:
        it.close()
