"""The commands of ``micromanip``, by name. Each module is imported when its command is used, and not before."""

from __future__ import annotations

import functools
import importlib

import click
from click.shell_completion import get_completion_class

from .options import Answer, StrictGroup, subcommand

SECTIONS = {
    "The cell": {
        "new": "a small configuration of your own cell, untuned",
        "check": "validate a configuration and print its budget",
        "run": "run a configuration: the daemon",
        "park": "bring all outputs to their safe value, without a controller",
        "status": "what the running controller does; --watch: the full screen",
        "arm": "start tracking, softly",
        "disarm": "stop tracking, softly",
        "hold": "freeze the correction",
        "reset": "clear a latched fault",
        "jog": "move an axis by hand",
        "log": "who asked for what, and when",
    },
    "Parameters of the running cell": {
        "get": "running values; --watch: a live stream of them",
        "set": "change running values",
        "diff": "the file against what runs",
        "save": "write running values into the file",
        "reload": "take over the file as it is now",
        "apply": "put a tuned file in force where the cell runs, or back",
        "candidate": "a candidate tuning beside what runs: set, show, promote, discard",
    },
    "Design, and what was recorded": {
        "commission": "from factory values to a tuned, validated axis, with its report",
        "identify": "play a safe excitation on one axis and record it",
        "fit": "models of a recording: hysteresis, linear, tracker",
        "analyse": "margins and error of an axis: margins, error, path, live, health",
        "evaluate": "the paper's experiment in virtual time",
        "recording": "start, stop, mark, list, view, report, compare, export",
        "replay": "a recorded run again: bit for bit, or under another tuning",
        "trip": "black boxes of trips in plain words: list, show",
        "learn": "corrects what repeats over parts: part, status, reset, export",
    },
    "Devices and the machine": {
        "device": "drivers, and what answers on a bus: list, probe, esi, simulate",
        "gateway": "scope, cell page and metrics for browsers",
        "system": "this machine as a controller: check, install, bench",
        "completion": "completion for a shell",
    },
}
"""What ``--help`` says of each command, in the order of the work."""
_MODULES = {
    **dict.fromkeys(("arm", "disarm", "hold", "reset", "jog", "log"), "orders"),
    **dict.fromkeys(("get", "set", "diff", "save", "reload"), "parameters"),
    "completion": "commands",
}
"""Modules of the commands that share one; each other command has one of its own, by its name."""
_EXAMPLE = "Example: micromanip run config/simulated.yaml --duration 10"


def _commands_in(*modules: str) -> dict[str, click.Command]:
    """The commands of these modules, by name, in the order in which they are written."""
    found = (each for name in modules for each in vars(importlib.import_module(f"micromanip.cli.{name}")).values())
    return {str(each.name): each for each in found if isinstance(each, click.Command)}


class LazyGroup(StrictGroup):
    """A group that imports its modules when one of its commands is used."""

    def __init__(self, name: str, example: str, *modules: str) -> None:
        """`modules` have its commands; without any there is one of its name."""
        does = next(section[name] for section in SECTIONS.values() if name in section)
        super().__init__(name, help=f"{does[0].upper()}{does[1:]}.", epilog=f"Example: micromanip {name} {example}")
        self._modules = modules or (name,)

    @functools.cached_property
    def _found(self) -> dict[str, click.Command]:
        return _commands_in(*self._modules)

    def list_commands(self, _: click.Context) -> list[str]:
        return list(self._found)

    def get_command(self, _: click.Context, cmd_name: str) -> click.Command | None:
        return self._found.get(cmd_name)


_GROUPS = {
    group.name: group
    for group in (
        LazyGroup("candidate", "set axes.x.outer.control_weight=12"),
        LazyGroup("fit", "hysteresis x.csv --input u --output y", "fit_hysteresis", "fit_linear", "fit_tracker"),
        LazyGroup(
            "analyse",
            "margins config/simulated.yaml --out out/analyse",
            *("analyse_margins", "analyse_error", "analyse_path", "analyse_live"),
        ),
        LazyGroup("recording", 'start; micromanip recording mark "coolant on"', "recording", "recording_report"),
        LazyGroup("trip", "show --to trip.html"),
        LazyGroup("learn", "status"),
        LazyGroup("device", "probe config/can.yaml can0", "device", "device_esi", "device_simulate"),
        LazyGroup("system", "check config/simulated.yaml"),
    )
}


class _Root(StrictGroup):
    """All commands; their help fits on one screen."""

    def list_commands(self, _: click.Context) -> list[str]:
        return [name for section in SECTIONS.values() for name in section]

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        if cmd_name in _GROUPS or cmd_name not in self.list_commands(ctx):
            return _GROUPS.get(cmd_name)
        return _commands_in(_MODULES.get(cmd_name, cmd_name)).get(cmd_name)

    def format_help(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Usage, the commands by sections, and an example, without empty lines between them."""
        self.format_usage(ctx, formatter)
        formatter.write(f"{self.help}\n\n")
        for title, section in SECTIONS.items():
            formatter.write(f"{title}:\n")
            formatter.indent()
            formatter.write_dl([(f"{name:10}", does) for name, does in section.items()])
            formatter.dedent()
        formatter.write("`micromanip COMMAND --help` explains a command; `micromanip --version`.\n")
        formatter.write(f"{_EXAMPLE}\n")


@subcommand("completion", 'eval "$(micromanip completion bash)"')
@click.argument("shell", type=click.Choice(["bash", "zsh", "fish"]))
@click.pass_context
def completion(context: click.Context, shell: str) -> Answer:
    """Print the completion script for SHELL."""
    kind = get_completion_class(shell)
    assert kind is not None
    script = kind(context.find_root().command, {}, "micromanip", "_MICROMANIP_COMPLETE").source()
    return Answer({"shell": shell, "script": script}, lambda: click.echo(script))


cli = click.version_option(package_name="micromanip")(
    _Root(
        "micromanip",
        context_settings={"help_option_names": ["-h", "--help"]},
        help="Hold a machining spindle on its path with a piezo-actuated micro manipulator.",
    )
)
