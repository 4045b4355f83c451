"""The command in a process of its own, with a foreign controller: python-can and cantools, nothing of the driver."""

import itertools
import json
import os
import signal
import subprocess
import sys
import time

import can
import cantools
import pytest

from campaigns.report import CONFIG

pytestmark = [pytest.mark.live, pytest.mark.xdist_group("loop")]  # an emulated device goes before ordinary work

CHANNEL = f"hil-{os.getpid()}"
PATIENCE_S = 60.0


@pytest.fixture
def config(tmp_path):
    text = (CONFIG / "can.yaml").read_text(encoding="utf-8")
    file = tmp_path / "cell.yaml"
    file.write_text(
        text.replace("channel: can0\n", f"channel: {CHANNEL}\n").replace(" can/", f" {CONFIG}/can/"), encoding="utf-8"
    )
    return file


def start(config, *options):
    return subprocess.Popen(
        [
            sys.executable,
            "-c",
            "from micromanip.cli.main import main; main()",
            "device",
            "simulate",
            str(config),
            *options,
        ],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


@pytest.fixture
def device(config):
    """The device, ready, with lines of commands."""
    process = start(config, "--commands", "--json", "--watchdog", "1000")
    assert process.stderr.readline() == f"READY {CHANNEL}: 2 messages out, 1 in, 1000/5000 kbit/s\n"
    yield process
    process.kill()
    process.communicate()


def ask(played, /, **command):
    played.stdin.write(json.dumps(command) + "\n")
    played.stdin.flush()
    return json.loads(played.stdout.readline())


def newest(bus, message):
    """Decode the next frame of a message that comes from now on."""
    while bus.recv(0) is not None:
        pass
    end = time.monotonic() + PATIENCE_S
    while time.monotonic() < end:
        received = bus.recv(1.0)
        if received is not None and received.arbitration_id == message.frame_id:
            return message.decode(received.data, decode_choices=False)
    raise AssertionError(f"no {message.name} came")


def test_foreign_controller_moves_an_axis(device):
    database = cantools.database.load_file(CONFIG / "can" / "manipulator.dbc")
    sensors, voltages = database.get_message_by_name("Sensors"), database.get_message_by_name("Voltages")
    values = dict.fromkeys((signal.name for signal in voltages.signals), 0) | {"amplifier_enable": 1}
    with can.Bus(interface="micromanip", channel=CHANNEL, fd=True, bitrate=1_000_000, data_bitrate=5_000_000) as bus:
        strains = []
        for volts in (0.0, 20.0, 40.0, 60.0):
            data = voltages.encode(values | {"voltage_y": volts})
            bus.send(can.Message(arbitration_id=256, data=data, is_fd=True, bitrate_switch=True, is_extended_id=False))
            time.sleep(0.1)
            strains.append(newest(bus, sensors)["strain_y"])
        gains = [(high - low) / 20.0 for low, high in itertools.pairwise(strains)]
        assert all(0.4 < gain < 1.5 for gain in gains), strains
        received = bus.recv(1.0)
        assert abs(time.monotonic() - received.timestamp) < PATIENCE_S, "stamps are of CLOCK_MONOTONIC"
    report = ask(device, report=True)
    assert report["outputs"]["voltage_y"]["max"] == pytest.approx(60.0, abs=0.003)
    assert report["outputs"]["voltage_y"]["samples"] == 4
    assert ask(device, report=True)["outputs"]["voltage_y"]["samples"] == 0


def test_ctrl_c_ends_it_with_one_line_of_figures(device):
    assert "error" in ask(device, device="explode")
    end = time.monotonic() + PATIENCE_S
    while not ask(device, report=True)["devices"]["can0"]["frames"]:
        assert time.monotonic() < end, "it sends nothing"
    device.send_signal(signal.SIGINT)
    out, err = device.communicate(timeout=PATIENCE_S)
    assert device.returncode == 0
    report = json.loads(out)
    assert report["devices"]["can0"]["frames"] > 0
    assert report["cpu_s"] < report["elapsed_s"]
    assert err == ""


def test_a_canopen_device_ends_with_its_summary(config):
    """It counts frames only: what the others count besides is left out, and is no bug."""
    canopen = CONFIG / "canopen.yaml"
    config.with_name("can").symlink_to(canopen.parent / "can")
    config.write_text(canopen.read_text().replace("channel: can0", f"channel: {CHANNEL}"))
    process = start(config, "--duration", "0.3")
    out, err = process.communicate(timeout=PATIENCE_S)
    assert process.returncode == 0, err
    row = next(line for line in out.splitlines() if line.startswith("│ can0"))
    assert [cell.strip() for cell in row.strip("│").split("│")][2:5] == ["-", "-", "-"]
