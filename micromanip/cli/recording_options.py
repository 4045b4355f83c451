"""Options of the commands that read a recording: which columns, which part, at which rate; and what was taken, told."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import click

from micromanip.errors import UsageError, require_axis, system_error

from .echo import echo
from .options import Quantity
from .progress import show_compiling
from .results import require_room

if TYPE_CHECKING:
    from micromanip.recordings import Telemetry
    from micromanip.replay.fitting import Models
    from micromanip.replay.window import Window
    from micromanip.settings.check import Prepared
    from micromanip.settings.schema.model import Configuration
    from micromanip.settings.text.source import Source

_FILE = click.Path(path_type=Path)


class Cut(click.ParamType):  # type: ignore[type-arg]  # generic in newer versions of click only
    """``FROM:TO`` in seconds; either may be left out."""

    name = "from:to"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> tuple[float, float]:
        """Both ends, the second infinite where it is left out."""
        if isinstance(value, tuple):
            return value
        first, colon, last = str(value).partition(":")
        seconds = Quantity("SecondsOrZero")
        ends = (
            seconds.convert(first, param, ctx) if first.strip() else 0.0,
            seconds.convert(last, param, ctx) if last.strip() else float("inf"),
        )
        if not colon or ends[0] >= ends[1]:
            self.fail(f"{value!r:.40} is no part of a recording: write FROM:TO in seconds, 1.5:20.", param, ctx)
        return ends


def recording_options(command: Callable[..., Any]) -> Callable[..., Any]:
    """``--time``, ``--cut``, ``--resample``, ``--keep-spikes``, ``--validate``, ``--into`` and ``--axis``."""
    options = (
        click.option(
            "--time", "time_name", metavar="NAME[:unit]",
            help="Column of the time; none: rows are even, every --dt.  [default: by its unit or name]",
        ),
        click.option("--cut", type=Cut(), help="Use this part only, in seconds from the first sample."),
        click.option("--resample", "rate_hz", type=Quantity("Hertz"), help="Rate to bring the recording to, Hz."),
        click.option("--keep-spikes", is_flag=True, help="Bridge no spikes: what is short and high is true."),
        click.option("--validate", type=_FILE, help="Recording with the same columns that is not fitted to."),
        click.option("--into", type=_FILE, help="Configuration file to put the model into, with --axis."),
        click.option("--axis", help="The axis that --into means."),
    )  # fmt: skip
    for option in reversed(options):
        command = option(command)
    return command


class Target(NamedTuple):
    """The axis of a configuration that a model is put into."""

    configuration: Configuration
    source: Source
    axis: str

    @classmethod
    def of(cls, into: Path | None, axis: str | None) -> Target | None:
        """None without options; what is wrong with them, or with the place, is said before anything is computed."""
        from micromanip.settings.load import load_with_source

        if (into is None) != (axis is None):
            raise UsageError("--into and --axis go together")
        if into is None or axis is None:
            return None
        configuration, source = load_with_source(into)
        require_axis(axis, configuration.axes, f" in {into}")
        require_room(into.parent, f"--into {into}")
        return cls(configuration, source, axis)

    def write(self, text: str) -> None:
        """The file's new text."""
        from micromanip.settings.write import write_atomically

        try:
            write_atomically(self.source.path, text)
        except OSError as problem:
            raise system_error(problem, f"--into {self.source.path}") from problem


def open_recording(file: Path) -> Telemetry:
    """A recording of ours; standard error says what it is, and where it is damaged, what is left out."""
    from micromanip.recordings import open_telemetry

    telemetry = open_telemetry(file)
    echo(f"read {telemetry.summary()}", err=True)
    warn_of_damage(telemetry)
    return telemetry


def warn_of_damage(telemetry: Telemetry) -> None:
    """On standard error, where a recording lacks something."""
    if told := telemetry.damage():
        echo(f"warning: {telemetry.file}: {told}", err=True)


def echo_sources(records: Iterable[Any]) -> None:
    """What was taken of each record, in a line, and under it what is unusual: on standard error."""
    for record in records:
        echo(f"read {record.told}", err=True)
        for note in record.notes:
            echo(f"  note: {note}", err=True)


def recorded_run(
    file: Path, config: Path | None, cut: tuple[float, float] | None, *, arming: bool = True
) -> tuple[Configuration, Prepared, Window, Models]:
    """The configuration of a recorded run, the tuning of `config` or its own, a piece of it, and the models of that."""
    from micromanip.replay.fitting import fit_models
    from micromanip.replay.window import recorded_configuration, require_comparable, take_window
    from micromanip.settings.check import prepared
    from micromanip.settings.text.source import Source

    show_compiling()
    telemetry = open_recording(file)
    source, recorded = recorded_configuration(telemetry)
    tuned = prepared(source if config is None else Source.read(config))
    require_comparable(recorded, tuned.configuration, file, tuned.source.path)
    window = take_window(telemetry, cut, arming=arming)
    return recorded, tuned, window, fit_models(window, recorded)
