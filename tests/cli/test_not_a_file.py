"""A pipe, a device, a socket or a folder where a file is to be read: an answer at once, and the code of its class."""

import os
import re
import socket
from pathlib import Path

import pytest

from .command import code_of

CONFIG = Path(__file__).parents[2] / "config"


@pytest.fixture(params=["pipe", "device", "socket", "folder"])
def no_file(request, tmp_path, monkeypatch):
    """Something of that kind, under a short name: a socket's is limited."""
    monkeypatch.chdir(tmp_path)
    file = Path("input")
    if request.param == "pipe":
        os.mkfifo(file)
    elif request.param == "device":
        file.symlink_to("/dev/zero")
    elif request.param == "folder":
        file.mkdir()
    else:
        with socket.socket(socket.AF_UNIX) as bound:
            bound.bind(str(file))
    return file


@pytest.mark.parametrize("command", ["check", "run", "device simulate", "park", "evaluate"])
def test_a_configuration(command, no_file, capsys):
    assert code_of(*command.split(), no_file) == 78
    assert re.search("not a regular file|a directory", capsys.readouterr().err)


@pytest.mark.parametrize("kind", ["hysteresis", "linear"])
def test_a_recording(kind, no_file, capsys):
    file = no_file.rename("recording")
    assert code_of("fit", kind, file, "--input", "u", "--output", "y") == 1
    assert re.search("not a regular file|Is a directory", capsys.readouterr().err)


def test_the_file_of_a_terminal(no_file, capsys):
    assert code_of("device", "esi", no_file) in (64, 69)
    assert re.search("not a regular file|Is a directory", capsys.readouterr().err)


def test_samples_of_the_reference(no_file, capsys):
    text = (CONFIG / "factory.yaml").read_text()
    assert "reference: {source: hold, offset_um: 66}" in text
    told = text.replace("reference: {source: hold, offset_um: 66}", "reference: {source: file, path: input}")
    Path("cell.yaml").write_text(told)
    assert code_of("check", "cell.yaml") == 78
    assert "reference.path: input can't be read" in capsys.readouterr().err


@pytest.mark.parametrize(("name", "old"), [("can", "can/manipulator.dbc"), ("canopen", "can/sensor.eds")])
def test_descriptions_of_a_bus(name, old, no_file, capsys):
    text = (CONFIG / f"{name}.yaml").read_text()
    file = no_file.rename(f"input{Path(old).suffix}")
    assert f": {old}" in text
    Path("cell.yaml").write_text(text.replace(f": {old}", f": {file}"))
    assert code_of("check", "cell.yaml") == 78
    assert "can't be read" in capsys.readouterr().err
