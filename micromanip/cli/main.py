"""``micromanip``: runs the command, turns errors into one line and an exit code."""

from __future__ import annotations

import atexit
import contextlib
import gc
import io
import json
import os
import sys
import traceback
from typing import Any, NoReturn

import click

from micromanip.errors import MicromanipError, system_error

from .commands import cli
from .echo import echo
from .options import JsonOutput

# Our matrices are small: more threads gain nothing, and beside another busy process they spin it ten times slower.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
atexit.register(gc.freeze)  # Python's last look for garbage would go through all that was imported

_USAGE = 64


def main(arguments: list[str] | None = None) -> Any:
    """Entry point; the exit codes are those of ``micromanip.errors``, and 64 for wrong usage."""
    standard_output, json_output = sys.stdout, JsonOutput()
    json_output.is_due = "--json" in (sys.argv[1:] if arguments is None else arguments)
    try:
        cli.main(args=arguments, prog_name="micromanip", standalone_mode=False, obj=json_output)
    except click.ClickException as problem:
        _show(problem)
        _end(_USAGE, problem.format_message(), json_output)
    except (click.Abort, KeyboardInterrupt):
        _end(130, "interrupted", json_output)
    except SystemExit as ended:
        # nobody reads any more: click has put another stream there and rich has ended us, each with 1
        if sys.stdout is standard_output and not isinstance(ended.__context__, BrokenPipeError):
            raise
        sys.stdout = standard_output
        _end_output()
        sys.exit(0)
    except MicromanipError as problem:
        _fail(problem, json_output)
    except OSError as problem:
        _fail(system_error(problem, "standard output" if _while_printing(problem) else None), json_output)
    except Exception as problem:
        bug(problem)
        _end(70, f"bug: {type(problem).__name__}: {problem}", json_output)


def _fail(problem: MicromanipError, json_output: JsonOutput) -> NoReturn:
    _complain(f"micromanip: {problem}")
    _end(problem.exit_code, str(problem), json_output)


def _end(code: int, error: str, json_output: JsonOutput) -> NoReturn:
    """Exit with `code`; who asked for JSON and has none yet gets the error as such."""
    if json_output.is_due:
        with contextlib.suppress(OSError):
            click.echo(json.dumps({"error": error, "exit_code": code}, indent=2))
    _end_output()
    sys.exit(code)


def _show(problem: click.ClickException) -> None:
    """What click says of wrong usage."""
    shown = io.StringIO()
    problem.show(file=shown)
    _complain(shown.getvalue().rstrip("\n"))


def _complain(message: str) -> None:
    """A line on standard error, if anybody still reads it."""
    with contextlib.suppress(OSError):
        echo(message, err=True)


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

    from micromanip.bus.registry import driver_at_fault, first_cause

    trace = "".join(traceback.format_exception(problem))
    try:
        with tempfile.NamedTemporaryFile("w", prefix="micromanip-", suffix=".trace", delete=False) as file:
            file.write(trace)
        how = f"with {file.name}"
    except OSError:
        how = f"with this:\n{trace}"
    driver = driver_at_fault(problem)
    if driver is None:
        _complain(f"micromanip: bug: {type(problem).__name__}: {problem}\nPlease report it {how}")
    else:
        _complain(f"micromanip: bug of {driver}: {first_cause(problem)}\nPlease report it to the driver's author {how}")
