"""A pipe, a device, a socket or a folder where a file is to be read: an answer at once, and the code of its class."""

import os
import re
import socket
from pathlib import Path

import pytest

from .command import code_of


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
