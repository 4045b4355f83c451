"""A command line, typed in this process; and every command that there is."""

import click

from micromanip.cli.commands import cli
from micromanip.cli.main import main


def code_of(*arguments):
    """Its exit code."""
    try:
        main(list(map(str, arguments)))
    except SystemExit as ended:
        return ended.code
    return 0


def _below(group, words=()):
    context = click.Context(group)
    for name in group.list_commands(context):
        command = group.get_command(context, name)
        found = (*words, name)
        yield from _below(command, found) if isinstance(command, click.Group) else [(found, command)]


COMMANDS = {" ".join(words): command for words, command in _below(cli)}
"""Every command by the words that call it."""
