"""``micromanip``: finds the command, turns errors into one line and an exit code."""

from __future__ import annotations

import contextlib
import importlib
import os
import sys
import traceback
from typing import Any, NoReturn

import click

from micromanip.errors import MicromanipError, system_error

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
    "drivers": "which drivers are installed, and whether they keep their contract",
    "probe": "what answers on a bus, and what it says",
    "bench": "speed of this machine, beside references",
    "safe-outputs": "bring all outputs to their safe value, with no controller running",
    "install-service": "run a configuration as a service of this machine",
    "completion": "shell completion",
}
_TOGETHER = {
    "orders": ("arm", "disarm", "hold", "reset"),
    "parameters": ("get", "set", "diff", "save", "reload"),
    "candidate": ("shadow", "promote", "withdraw"),
}
"""Commands that share a module; every other has one of its own, by its name."""
_USAGE = 64


class LazyGroup(click.Group):
    """Imports a command's module only when that command is used: `status` need not load a compiler."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        return list(COMMANDS)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        if cmd_name not in COMMANDS:
            return None
        own = cmd_name.replace("-", "_")
        name = next((shared for shared, names in _TOGETHER.items() if cmd_name in names), own)
        module = importlib.import_module(f"micromanip.cli.{name}")
        return next(c for c in vars(module).values() if isinstance(c, click.Command) and c.name == cmd_name)

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
    output = sys.stdout
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
    except SystemExit as ended:
        # nobody reads any more: click has put another stream there and rich has ended us, each with 1
        if sys.stdout is output and not isinstance(ended.__context__, BrokenPipeError):
            raise
        sys.stdout = output
        _end_output()
        sys.exit(0)
    except MicromanipError as problem:
        _fail(problem)
    except OSError as problem:
        _fail(system_error(problem, "standard output" if _while_printing(problem) else None))
    except Exception as problem:
        bug(problem)
        sys.exit(70)


def _fail(problem: MicromanipError) -> NoReturn:
    _say(f"micromanip: {problem}")
    _end_output()
    sys.exit(problem.exit_code)


def _say(message: str) -> None:
    """A line on standard error, if anybody still reads it."""
    with contextlib.suppress(OSError):
        click.echo(message, err=True)


def _while_printing(problem: OSError) -> bool:
    """Whether it was raised as something was printed."""
    modules = [frame.f_globals.get("__name__") for frame, _ in traceback.walk_tb(problem.__traceback__)]
    return not {"click.utils", "rich.console"}.isdisjoint(modules)


def _end_output() -> None:
    """Where what was printed can't be written, nothing more is: not even Python's complaint about that at the end."""
    try:
        if sys.stdout is not None:
            sys.stdout.flush()
    except OSError:
        nowhere = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nowhere, sys.stdout.fileno())
        os.close(nowhere)


def bug(problem: Exception) -> None:
    """What we did not foresee: one line for the user, the trace in a file for us."""
    import tempfile

    trace = "".join(traceback.format_exception(problem))
    try:
        with tempfile.NamedTemporaryFile("w", prefix="micromanip-", suffix=".trace", delete=False) as file:
            file.write(trace)
        next_step = f"Please report it with {file.name}"
    except OSError:
        next_step = f"Please report it with this:\n{trace}"
    _say(f"micromanip: bug: {type(problem).__name__}: {problem}\n{next_step}")
