"""``micromanip``: finds the command, turns errors into one line and an exit code."""

from __future__ import annotations

import atexit
import contextlib
import gc
import importlib
import io
import json
import os
import sys
import traceback
from typing import Any, NoReturn

import click

from micromanip.errors import MicromanipError, system_error

from .options import StrictGroup, Told
from .prose import say

# Our matrices are small: more threads gain nothing, and beside another busy process they spin it ten times slower.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
atexit.register(gc.freeze)  # Python's last look for garbage would go through all that was imported

GROUPS = {
    "The running cell": {
        "run": "run a configuration: the daemon",
        "status": "what the running controller does, and each axis",
        "top": "the same over the whole screen, live, with keys",
        "gateway": "scope, cell page and metrics for browsers",
        "arm": "start tracking, softly",
        "disarm": "stop tracking, softly",
        "hold": "freeze the correction",
        "reset": "clear a latched fault",
        "part": "say that a part begins or ends: to what learns",
        "jog": "move an axis by hand",
        "sensitivity": "margins of a loop, measured while it runs",
        "drift": "whether an axis is still the one that was commissioned",
        "record": "record the running cell: start, stop, mark",
        "export": "a recording in the formats of other programs",
        "view": "a recording on the scope, in browsers",
        "report": "a recorded run as one page",
        "compare": "two recorded runs side by side, and whether they differ",
        "replay": "a recorded run again: bit for bit, or under another tuning",
        "recording": "the recordings of a folder",
        "explain": "a trip in plain words, from its black box",
        "audit": "who asked for what, and when",
    },
    "Parameters of the running cell": {
        "get": "running values",
        "set": "change running values",
        "shadow": "let a candidate tuning compute beside what runs",
        "promote": "put the candidate in force, on trial",
        "withdraw": "let the candidate go, or take it back",
        "diff": "the file against what runs",
        "save": "write running values into the file",
        "reload": "take over the file as it is now",
    },
    "Design and tuning": {
        "check": "validate a configuration and print its budget",
        "commission": "from factory values to a tuned, validated axis, with its report",
        "identify": "play a safe excitation on one axis and record it",
        "fit": "models from a recording",
        "learn": "what repeats of the path error from part to part, and a correction for it",
        "sweep": "thousands of tunings tried on recordings, the best of them",
        "analyse": "describing function, margins and robustness, with a verdict",
        "budget": "what the path error is made of, and what would make it smaller",
        "preview": "whether the stage reaches a path, before a part is mounted",
        "evaluate": "the paper's experiment in virtual time",
    },
    "Devices and the machine": {
        "drivers": "which drivers are installed, and whether they keep their contract",
        "probe": "what answers on a bus, and what it says",
        "ethercat": "what a terminal's ESI file says, as a configuration",
        "simulate-device": "play the devices that a configuration names",
        "safe-outputs": "bring all outputs to their safe value, with no controller running",
        "rtcheck": "whether this machine keeps the deadlines, and what would mend it",
        "bench": "speed of this machine, beside references",
        "install-service": "run a configuration as a service of this machine",
        "completion": "shell completion",
    },
}
COMMANDS = {name: does for group in GROUPS.values() for name, does in group.items()}
_TOGETHER = {
    "orders": ("arm", "disarm", "hold", "reset"),
    "parameters": ("get", "set", "diff", "save", "reload"),
    "candidate": ("shadow", "promote", "withdraw"),
    "recording_list": ("recording",),
}
"""Commands that share a module; every other has one of its own, by its name."""
_USAGE = 64


class LazyGroup(StrictGroup):
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
        width = max(map(len, COMMANDS))
        for title, commands in GROUPS.items():
            with formatter.section(title):
                formatter.write_dl([(f"{name:{width}}", does) for name, does in commands.items()])


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
    output, told = sys.stdout, Told()
    told.is_owed = "--json" in (sys.argv[1:] if arguments is None else arguments)
    try:
        cli.main(args=arguments, prog_name="micromanip", standalone_mode=False, obj=told)
    except click.ClickException as problem:
        _show(problem)
        _end(_USAGE, problem.format_message(), told)
    except (click.Abort, KeyboardInterrupt):
        _end(130, "interrupted", told)
    except SystemExit as ended:
        # nobody reads any more: click has put another stream there and rich has ended us, each with 1
        if sys.stdout is output and not isinstance(ended.__context__, BrokenPipeError):
            raise
        sys.stdout = output
        _end_output()
        sys.exit(0)
    except MicromanipError as problem:
        _fail(problem, told)
    except OSError as problem:
        _fail(system_error(problem, "standard output" if _while_printing(problem) else None), told)
    except Exception as problem:
        bug(problem)
        _end(70, f"bug: {type(problem).__name__}: {problem}", told)


def _fail(problem: MicromanipError, told: Told) -> NoReturn:
    _say(f"micromanip: {problem}")
    _end(problem.exit_code, str(problem), told)


def _end(code: int, error: str, told: Told) -> NoReturn:
    """Exit with `code`; who asked for JSON and has none yet gets the error as such."""
    if told.is_owed:
        with contextlib.suppress(OSError):
            click.echo(json.dumps({"error": error, "exit_code": code}, indent=2))
    _end_output()
    sys.exit(code)


def _show(problem: click.ClickException) -> None:
    """What click says of wrong usage."""
    shown = io.StringIO()
    problem.show(file=shown)
    _say(shown.getvalue().rstrip("\n"))


def _say(message: str) -> None:
    """A line on standard error, if anybody still reads it."""
    with contextlib.suppress(OSError):
        say(message, err=True)


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
    """What nobody foresaw: one line for the user, the trace in a file for us, or for the author of a driver."""
    import tempfile

    from micromanip.bus.authors import driver_at_fault, first_cause

    trace = "".join(traceback.format_exception(problem))
    try:
        with tempfile.NamedTemporaryFile("w", prefix="micromanip-", suffix=".trace", delete=False) as file:
            file.write(trace)
        how = f"with {file.name}"
    except OSError:
        how = f"with this:\n{trace}"
    driver = driver_at_fault(problem)
    if driver is None:
        _say(f"micromanip: bug: {type(problem).__name__}: {problem}\nPlease report it {how}")
    else:
        _say(f"micromanip: bug of {driver}: {first_cause(problem)}\nPlease report it to the driver's author {how}")
