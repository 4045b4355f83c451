"""Shells complete the names of axes: quickly, and silently where they can't be told."""

import json
import os
import shutil
import socket
import subprocess
import sys
import threading
import time
from pathlib import Path

import click
import pytest
from click.shell_completion import ShellComplete

from micromanip.cli import axis_names
from micromanip.cli.main import GROUPS, cli

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


@pytest.fixture
def controller(tmp_path):
    """The path of a socket on which somebody says what runs."""
    path = tmp_path / "control.sock"
    with socket.socket(socket.AF_UNIX) as listening:
        listening.bind(str(path))
        listening.listen()

        def answer():
            try:
                one = listening.accept()[0]
            except OSError:  # nobody has come
                return
            with one, one.makefile("rwb") as lines:
                asked = json.loads(lines.readline())
                assert asked["verb"] == "status"
                lines.write(json.dumps({"ok": True, "result": {"axes": {"x": {}, "y": {}}}}).encode() + b"\n")

        answering = threading.Thread(target=answer, daemon=True)
        answering.start()
        yield path
        listening.shutdown(socket.SHUT_RDWR)
        answering.join(30.0)


def completed(*words):
    """What completes the last of the words."""
    *before, incomplete = map(str, words)
    found = ShellComplete(cli, {}, "micromanip", "_").get_completions(before, incomplete)
    return [item.value for item in found]


@pytest.mark.parametrize(
    "words",
    [
        ["identify", "FILE", "--seconds", "5", "--axis", ""],
        ["sensitivity", "FILE", "--axis", ""],
        ["evaluate", "FILE", "--axis", ""],
        ["fit", "hysteresis", "r.csv", "--into", "FILE", "--axis", ""],
    ],
)
def test_one_axis_of_the_file(words, file):
    assert completed(*(str(file) if word == "FILE" else word for word in words)) == ["left", "up"]


@pytest.mark.parametrize("verb", ["analyse", "budget", "commission", "drift"])
def test_an_axis_or_all_of_the_file(verb, file):
    assert completed(verb, file, "--axis", "") == ["left", "up", "all"]
    assert completed(verb, file, "--axis", "l") == ["left"]


def test_preview_takes_the_axes_of_its_cell(file, tmp_path):
    path = tmp_path / "path.csv"
    path.write_text("t_s,deviation_left_um\n0,0\n")
    assert completed("preview", path, "--config", file, "--axis", "u") == ["up"]


def test_axes_of_the_running_controller(controller):
    assert completed("jog", "--socket", controller, "") == ["x", "y"]


def test_a_file_goes_before_the_running_controller(controller, file):
    assert completed("drift", file, "--socket", controller, "--axis", "") == ["left", "up", "all"]


@pytest.mark.parametrize("text", ["axes: {x: [", "axes: 5\n", "- 1\n", "\0\1", ""])
def test_a_configuration_that_is_none_completes_to_nothing(text, tmp_path, capsys):
    file = tmp_path / "cell.yaml"
    file.write_text(text)
    assert completed("analyse", file, "--axis", "") == []
    assert completed("analyse", tmp_path / "missing.yaml", "--axis", "") == []
    assert completed("analyse", "--axis", "") == []
    assert completed("jog", "--socket", tmp_path / "none.sock", "") == []
    assert capsys.readouterr() == ("", "")


def test_who_hangs_is_not_waited_for(tmp_path, monkeypatch):
    monkeypatch.setattr(axis_names, "_PATIENCE_S", 0.2)
    path = tmp_path / "control.sock"
    with socket.socket(socket.AF_UNIX) as listening:
        listening.bind(str(path))
        listening.listen()
        begin = time.monotonic()
        assert completed("jog", "--socket", path, "") == []
    assert time.monotonic() - begin < 5.0
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    assert completed("analyse", pipe, "--axis", "") == []


def test_every_command_that_takes_an_axis_completes_it():
    def commands(group, context):
        for name in group.list_commands(context):
            found = group.get_command(context, name)
            yield from commands(found, context) if isinstance(found, click.Group) else [found]

    assert GROUPS
    named = [
        (command.name, param)
        for command in commands(cli, click.Context(cli))
        for param in command.params
        if "--axis" in param.opts or param.name == "axis"
    ]
    assert len(named) > 10
    assert not [name for name, param in named if param._custom_shell_complete is None]


def test_no_compiler_and_no_schema_is_loaded(file):
    """A shell waits for it."""
    code = (
        "import sys; from click.shell_completion import ShellComplete as S; from micromanip.cli.main import cli\n"
        f"assert len(S(cli, {{}}, 'micromanip', '_').get_completions(['drift', {str(file)!r}, '--axis'], '')) == 3\n"
        "print({'numba', 'numpy', 'scipy', 'rich', 'micromanip.settings.schema.model'} & set(sys.modules))"
    )
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout == "set()\n"


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
    words = ["micromanip", "drift", str(file), "--axis"]
    path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    arguments = ["--norc", "-c", script, "bash"] if shell == "bash" else ["--no-config", "-c", script]
    said = subprocess.run(
        [program, *arguments, *words], env={**os.environ, "PATH": path}, capture_output=True, text=True, check=False
    )
    assert said.stderr == ""
    assert sorted(said.stdout.split()) == ["all", "left", "up"]
