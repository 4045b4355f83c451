"""``micromanip``: finds the command, turns errors into one line and an exit code."""

from __future__ import annotations

import importlib
import os
import sys
from typing import Any

import click

from micromanip.errors import MicromanipError

# Our matrices are small: more threads gain nothing, and beside another busy process they spin it ten times slower.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

COMMANDS = {
    "run": "run a configuration: the daemon",
    "check": "validate a configuration and print its budget",
    "simulate-device": "play the devices that a configuration names",
    "commission": "from factory values to a tuned, validated axis, with its report",
    "identify": "play a safe excitation on one axis and record it",
    "fit": "models from a recording",
    "evaluate": "the paper's experiment in virtual time",
    "analyse": "describing function, margins and robustness, with a verdict",
    "status": "what the running controller does",
    "arm": "start tracking, softly",
    "disarm": "stop tracking, softly",
    "hold": "freeze the correction",
    "reset": "clear a latched fault",
    "explain": "a trip in plain words, from its black box",
    "jog": "move an axis by hand",
    "get": "running values",
    "set": "change running values",
    "shadow": "let a candidate tuning compute beside what runs",
    "promote": "put the candidate in force, on trial",
    "withdraw": "let the candidate go, or take it back",
    "diff": "the file against what runs",
    "save": "write running values into the file",
    "reload": "take over the file as it is now",
    "audit": "who asked for what, and when",
    "bench": "speed of this machine, beside references",
    "safe-outputs": "bring all outputs to their safe value, with no controller running",
    "install-service": "run a configuration as a service of this machine",
    "completion": "shell completion",
}
_USAGE = 64


class LazyGroup(click.Group):
    """Imports a command's module only when that command is used: `status` need not load a compiler."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        return list(COMMANDS)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        if cmd_name not in COMMANDS:
            return None
        module = importlib.import_module(f"micromanip.cli.{cmd_name.replace('-', '_')}")
        command: click.Command = module.command
        return command

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        with formatter.section("Commands"):
            formatter.write_dl(list(COMMANDS.items()))


@click.group(
    cls=LazyGroup,
    context_settings={"help_option_names": ["-h", "--help"]},
    epilog="Example: micromanip run config/simulated.yaml --duration 10",
)
@click.version_option(package_name="micromanip")
def cli() -> None:
    """Hold a machining spindle on its path with a piezo-actuated micro manipulator."""


def main(arguments: list[str] | None = None) -> Any:
    """Entry point; the exit codes are those of ``micromanip.errors``, and 64 for wrong usage."""
    try:
        cli.main(args=arguments, prog_name="micromanip", standalone_mode=False)
    except click.UsageError as problem:
        problem.show()
        sys.exit(_USAGE)
    except click.ClickException as problem:
        problem.show()
        sys.exit(_USAGE)
    except (click.Abort, KeyboardInterrupt):
        sys.exit(130)
    except BrokenPipeError:
        sys.exit(0)
    except MicromanipError as problem:
        click.echo(f"micromanip: {problem}", err=True)
        sys.exit(problem.exit_code)
    except Exception as problem:
        bug(problem)
        sys.exit(70)


def bug(problem: Exception) -> None:
    """What we did not foresee: one line for the user, the trace in a file for us."""
    import tempfile
    import traceback

    with tempfile.NamedTemporaryFile("w", prefix="micromanip-", suffix=".trace", delete=False) as file:
        traceback.print_exception(problem, file=file)
    click.echo(f"micromanip: bug: {type(problem).__name__}: {problem}\nPlease report it with {file.name}", err=True)
