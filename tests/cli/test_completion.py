"""Shells complete the names of axes: quickly, and silently where they can't be told."""

import pytest
from click.shell_completion import ShellComplete

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


def test_every_command_that_takes_an_axis_completes_it():
    named = [
        (name, param)
        for name, command in COMMANDS.items()
        for param in command.params
        if "--axis" in param.opts or param.name == "axis"
    ]
    assert len(named) > 10
    assert not [name for name, param in named if param._custom_shell_complete is None]
