"""Options and output that several commands share."""

from __future__ import annotations

import functools
import json
import math
from collections.abc import Callable, Collection, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

import click

from micromanip.client import Client, default_socket
from micromanip.errors import nearest, require_axis

from .echo import echo

_Answer = TypeVar("_Answer")
_WHOLE = 1000


class StrictCommand(click.Command):
    """A command whose options are given once each: of two values nobody knows which was meant."""

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        """As click does, which would let the last one win."""
        if not ctx.resilient_parsing:
            _, _, order = self.make_parser(ctx).parse_args(args=list(args))
            for option in order:
                if (
                    isinstance(option, click.Option)
                    and not (option.multiple or option.count)
                    and order.count(option) > 1
                ):
                    raise click.UsageError(f"{'/'.join(option.opts)} is given more than once", ctx)
        return super().parse_args(ctx, args)


class StrictGroup(click.Group):
    """Commands of one name; the help shows the whole first sentence of each."""

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """As click does, which ends what a command does with three dots."""
        commands = [(name, self.get_command(ctx, name)) for name in self.list_commands(ctx)]
        with formatter.section("Commands"):
            formatter.write_dl([(name, each.get_short_help_str(_WHOLE)) for name, each in commands if each])

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        """As click does; a name that is not there gets the nearest one that is."""
        known = self.list_commands(ctx)
        if args and not args[0].startswith("-") and args[0] not in known:
            near = nearest(args[0], known)
            hint = f"did you mean {near}?" if near else f"`{ctx.command_path} --help` lists them."
            raise click.UsageError(f"There is no command {args[0]!r:.40}; {hint}", ctx)
        return super().resolve_command(ctx, args)


class Quantity(click.ParamType):  # type: ignore[type-arg]  # generic in newer versions of click only
    """A number with the bounds that its unit has in the file (``micromanip.quantities``), or narrower ones."""

    def __init__(self, unit: str, *, least: float | None = None, most: float | None = None) -> None:
        """`unit` names the type; it is looked up with the first number: most commands are to start quickly."""
        self.name = "number"
        self._unit, self._least, self._most = unit, least, most

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> float:
        """The number, finite and within the bounds; a default is one already."""
        if isinstance(value, int | float):
            return value
        low, high, whole = self.bounds()
        try:
            number = int(value) if whole else float(value)
        except ValueError:
            number = math.nan
        if not low <= number <= high:
            kind = "whole number" if whole else "number"
            self.fail(f"{value!r:.40} is not a {kind} from {low:.10g} to {high:.10g}.", param, ctx)
        return number

    def bounds(self) -> tuple[float, float, bool]:
        """Lowest and highest value, and whether it is a whole number."""
        from pydantic import TypeAdapter

        from micromanip import quantities

        schema = TypeAdapter(getattr(quantities, self._unit)).json_schema()
        low = schema["minimum"] if self._least is None else max(self._least, schema["minimum"])
        high = schema["maximum"] if self._most is None else min(self._most, schema["maximum"])
        return low, high, schema["type"] == "integer"


axis_option = click.option("--axis", "only", default="all", help="One axis, or all.")
one_axis_option = click.option("--axis", required=True, help="The axis.")
moved_axis_option = click.option("--axis", "only", required=True, help="One axis, or all, one after the other.")
config_argument = click.argument("config", type=click.Path(path_type=Path), metavar="CONFIG")
json_option = click.option("--json", "as_json", is_flag=True, help="One JSON document on standard output.")
socket_option = click.option(
    "--socket",
    "socket_path",
    show_default=False,
    type=click.Path(path_type=Path, readable=False),  # the client says whom it lets in
    default=default_socket,
    help=f"Control socket.  [default: {default_socket()}]",
)


@dataclass(frozen=True)
class Answer:
    """What a command has found: a document for ``--json``, `show` for people, and why it ends badly, if it does."""

    document: Any
    show: Callable[[], object] = lambda: None
    problem: BaseException | None = None


def subcommand(name: str, example: str, **how: Any) -> Callable[[Callable[..., Any]], click.Command]:
    """Decorator of a command: its `Answer` is printed as ``--json`` has it or for people, then its problem is raised.

    An `example` stands at the end of its help, which shows all defaults.
    """
    begin = "\b\n" if "\n" in example else ""

    def decorate(function: Callable[..., Answer | None]) -> click.Command:
        @functools.wraps(function)
        def command(*arguments: Any, as_json: bool, **given: Any) -> None:
            answer = function(*arguments, **given)
            if answer is None:
                return
            try:
                emit_json(answer.document) if as_json else answer.show()
            finally:  # also where nobody reads it
                if answer.problem is not None:
                    raise answer.problem

        options = json_option(command).__click_params__  # type: ignore[attr-defined]  # click's own list, in reverse
        options.insert(0, options.pop())
        settings = {"show_default": True, **how.pop("context_settings", {})}
        epilog = f"{begin}Example: {example}"
        return click.command(name, cls=StrictCommand, epilog=epilog, context_settings=settings, **how)(command)

    return decorate


def wants_json() -> bool:
    """Whether the present command is to print JSON."""
    return bool(click.get_current_context().params["as_json"])


def chosen_axes(axes: Collection[str], only: str, file: Path) -> list[str]:
    """What `axis_option` means of the `axes` in `file`; UsageError where there is no such one."""
    if only != "all":
        require_axis(only, axes, f" in {file}")
    return list(axes) if only == "all" else [only]


def warn(warnings: Iterable[str]) -> None:
    """A line each on standard error."""
    for warning in warnings:
        echo(f"WARNING: {warning}", err=True)


class JsonOutput:
    """Whether the one JSON document that ``--json`` promises is still to be written to standard output."""

    is_due = False


def emit_json(document: Any) -> None:
    """Print `document` as the only thing on standard output; JSON has no word for what is not a finite number."""
    claim_json()
    click.echo(json.dumps(_plain(document), indent=2, allow_nan=False))


def emit_json_lines(documents: Iterable[Any]) -> None:
    """Print each document on a line of its own, as it comes."""
    claim_json()
    for document in documents:
        click.echo(json.dumps(_plain(document), allow_nan=False))


class Messages(list[str]):
    """Lines of a command that serves until it is ended: each goes to standard error as it comes, and stays here."""

    def __call__(self, line: str) -> None:
        """Another line."""
        echo(line, err=True)
        self.append(line)


def client_command(
    show: Callable[[_Answer], object],
) -> Callable[[Callable[..., Callable[[Client], _Answer]]], Callable[..., Answer]]:
    """Decorator of a command to the running controller, with the options that go with it.

    The function looks at its own arguments, before anybody is asked, and says what to ask; `show` prints the answer.
    """

    def decorate(function: Callable[..., Callable[[Client], _Answer]]) -> Callable[..., Answer]:
        @socket_option
        @functools.wraps(function)
        def command(socket_path: Path, **given: Any) -> Answer:
            ask = function(**given)
            with Client(socket_path) as client:
                answer = ask(client)
            return Answer(answer, lambda: show(answer))

        return command

    return decorate


def claim_json() -> None:
    """What is printed from here on is the JSON that was asked for: an error gets none of its own."""
    context = click.get_current_context(silent=True)
    output = None if context is None else context.find_object(JsonOutput)
    if output is not None:
        output.is_due = False


def _plain(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _plain(entry) for key, entry in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(entry) for entry in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
