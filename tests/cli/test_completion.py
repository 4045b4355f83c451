"""Shells complete the names of axes: quickly, and silently where they can't be told."""

import os
import shutil
import socket
import subprocess
import sys
import time
from pathlib import Path

import pytest
from click.shell_completion import ShellComplete

from micromanip.cli import axes
from micromanip.cli.main import cli

from .command import COMMANDS

CONFIG = """axes:
  left: {}
  up: {}
  'a b,*': {}
"""


@pytest.fixture
def file(tmp_path):
    """A configuration of two axes with names that a shell may be given, and one that it may not."""
    path = tmp_path / "cell.yaml"
    path.write_text(CONFIG)
    return path


def completed(*words):
    """What completes the last of the words."""
    *before, incomplete = map(str, words)
    found = ShellComplete(cli, {}, "micromanip", "_").get_completions(before, incomplete)
    return [item.value for item in found]


@pytest.mark.parametrize(
    "words",
    [
        ["identify", "FILE", "--seconds", "5", "--axis", ""],
        ["analyse", "live", "FILE", "--axis", ""],
        ["evaluate", "FILE", "--axis", ""],
        ["fit", "hysteresis", "r.csv", "--into", "FILE", "--axis", ""],
    ],
)
def test_one_axis_of_the_file(words, file):
    assert completed(*(str(file) if word == "FILE" else word for word in words)) == ["left", "up"]


@pytest.mark.parametrize("verb", ["analyse margins", "analyse error", "commission", "analyse health"])
def test_an_axis_or_all_of_the_file(verb, file):
    assert completed(*verb.split(), file, "--axis", "") == ["left", "up", "all"]
    assert completed(*verb.split(), file, "--axis", "l") == ["left"]


def test_who_hangs_is_not_waited_for(tmp_path, monkeypatch):
    monkeypatch.setattr(axes, "_PATIENCE_S", 0.2)
    path = tmp_path / "control.sock"
    with socket.socket(socket.AF_UNIX) as listening:
        listening.bind(str(path))
        listening.listen()
        begin = time.monotonic()
        assert completed("jog", "--socket", path, "") == []
    assert time.monotonic() - begin < 5.0
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    assert completed("analyse", "margins", pipe, "--axis", "") == []


def test_every_command_that_takes_an_axis_completes_it():
    named = [
        (name, param)
        for name, command in COMMANDS.items()
        for param in command.params
        if "--axis" in param.opts or param.name == "axis"
    ]
    assert len(named) > 10
    assert not [name for name, param in named if param._custom_shell_complete is None]


BASH = """
eval "$(micromanip completion bash)"
COMP_WORDS=("$@" "")
COMP_CWORD=$#
_micromanip_completion micromanip "" ""
printf '%s\\n' "${COMPREPLY[@]}"
"""
FISH = 'micromanip completion fish | source\ncomplete -C "$argv "'


@pytest.mark.parametrize(("shell", "script"), [("bash", BASH), ("fish", FISH)])
def test_a_real_shell(shell, script, file):
    program = shutil.which(shell)
    if program is None:
        pytest.skip(f"{shell} is not installed")
    words = ["micromanip", "analyse", "health", str(file), "--axis"]
    path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    arguments = ["--norc", "-c", script, "bash"] if shell == "bash" else ["--no-config", "-c", script]
    said = subprocess.run(
        [program, *arguments, *words], env={**os.environ, "PATH": path}, capture_output=True, text=True, check=False
    )
    assert said.stderr == ""
    assert sorted(said.stdout.split()) == ["all", "left", "up"]
