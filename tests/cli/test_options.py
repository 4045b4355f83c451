"""What holds for the options of every command: given once, numbers within the bounds of their unit."""

import click
import pytest

from micromanip.cli.options import Quantity, StrictCommand

from .command import COMMANDS, code_of

ONCE = [
    (name, option) for name, command in COMMANDS.items() for option in command.params
    if isinstance(option, click.Option) and not option.multiple
]  # fmt: skip
NUMBERS = [
    (name, each) for name, command in COMMANDS.items() for each in command.params if isinstance(each.type, Quantity)
]


def refusal(capsys, *arguments):
    assert code_of(*arguments) == 64
    return capsys.readouterr().err


@pytest.mark.parametrize("name", COMMANDS)
def test_every_command_takes_each_option_once(name):
    assert isinstance(COMMANDS[name], StrictCommand)


@pytest.mark.parametrize(("name", "option"), ONCE, ids=lambda each: getattr(each, "name", each))
def test_an_option_given_twice_is_named(name, option, capsys):
    text = [option.opts[0]] if option.is_flag else [option.opts[0], "1"]
    assert f"{'/'.join(option.opts)} is given more than once" in refusal(capsys, *name.split(), *text, *text)


def test_an_axis_given_twice_moves_none(tmp_path, capsys):
    message = refusal(capsys, "identify", "none.yaml", "--axis", "x", "--axis", "y", "--out", str(tmp_path / "out"))
    assert "--axis is given more than once" in message
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("name", COMMANDS)
def test_every_number_has_bounds(name):
    for each in COMMANDS[name].params:
        assert not isinstance(each.type, click.types.FloatParamType), each.name  # of a range also: it takes NaN
        if isinstance(each.type, click.types.IntParamType):
            assert None not in (getattr(each.type, "min", None), getattr(each.type, "max", None)), each.name


@pytest.mark.parametrize("text", ["nan", "inf", "-inf", "-1e300", "1e300", "1" * 400, "fast", ""])
@pytest.mark.parametrize(("name", "number"), NUMBERS, ids=lambda each: getattr(each, "name", each))
def test_no_number_that_none_could_mean(name, number, text, capsys):
    given = [f"{number.opts[0]}={text}"] if isinstance(number, click.Option) else ["--", "x", text]
    needed = [each for each in COMMANDS[name].params if isinstance(each, click.Argument) and each.required]
    before = [] if given[0] == "--" else ["x"] * len(needed)
    message = refusal(capsys, *name.split(), *given, *before)
    assert " number from " in message
