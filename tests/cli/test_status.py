"""``micromanip status`` before a played controller: what is said, once, and in which colour."""

import os
import pty
import subprocess
import sys
from pathlib import Path

import pytest

from .command import code_of
from .played import FAULT, Played, status

RED = "\x1b[1;31m"


@pytest.fixture
def played(tmp_path):
    controller = Played(tmp_path / "control.sock")
    controller.status = status("FAULT", [FAULT])
    yield controller
    controller.close()


def on_a_terminal(controller, **environment):
    """What `status` writes to a terminal of 100 columns."""
    master, slave = pty.openpty()
    environment = os.environ | {"TERM": "xterm-256color", "COLUMNS": "100"} | environment
    command = [Path(sys.executable).with_name("micromanip"), "status", "--socket", str(controller.path)]
    subprocess.run(command, stdout=slave, env=environment, check=True)
    os.close(slave)
    written = b""
    while chunk := _read(master):
        written += chunk
    os.close(master)
    return written.decode()


def _read(descriptor):
    try:
        return os.read(descriptor, 65536)
    except OSError:  # the terminal is closed, and empty
        return b""


def test_a_fault_is_said_once_and_before_the_values(played, capsys):
    assert code_of("status", "--socket", played.path) == 0
    out = capsys.readouterr().out
    assert out.count("X-201") == 1
    assert out.index("FAULT") < out.index("X-201") < out.index("position, um")
    assert "\x1b" not in out, "colours are for terminals"


def test_a_sensor_that_an_axis_does_not_have_has_no_row(played, capsys):
    """Where it has one that says nothing, the row and its reason stay."""
    played.status = status(position=(None, "no signal stage_x"))
    assert code_of("status", "--socket", played.path) == 0
    assert "position" not in capsys.readouterr().out
    played.status = status(position=(None, "stale: no usable sample of stage_x for 5 ms"))
    assert code_of("status", "--socket", played.path) == 0
    assert "no usable sample of stage_x" in capsys.readouterr().out


def test_an_axis_that_is_not_as_good_as_it_may_be_is_named(played, capsys):
    report = status()
    report["axes"] = {
        "x": report["axes"]["x"] | {"untuned": True},
        "y": report["axes"]["y"] | {"less": "sigma at 10 Hz: 5.6 um"},
    }
    played.status = report
    assert code_of("status", "--socket", played.path) == 0
    out = capsys.readouterr().out
    assert "axis x: UNTUNED, in open loop: `micromanip commission`" in out
    assert "axis y: PASS WITH LESS: sigma at 10 Hz: 5.6 um" in out


def test_a_fault_is_red_on_a_terminal_and_plain_where_nobody_wants_colours(played):
    shown = on_a_terminal(played)
    assert f"{RED}X-201 axis x" in shown
    plain = on_a_terminal(played, NO_COLOR="1")
    assert "X-201 axis x" in plain
    assert "31m" not in plain
