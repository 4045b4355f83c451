"""``micromanip device list`` and ``probe``: installed drivers, and what answers on their buses."""

from __future__ import annotations

import contextlib
import sys
from collections.abc import Iterator
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from micromanip.errors import CheckFailed, DeviceUnavailable, UsageError

from .echo import echo
from .options import Answer, Quantity, config_argument, subcommand, wants_json

if TYPE_CHECKING:
    from rich.live import Live
    from rich.table import Table

    from micromanip.bus.cyclic import CyclicDriver
    from micromanip.bus.driver import Answer as Found
    from micromanip.bus.driver import BusDriver
    from micromanip.bus.registry import Inspected


@subcommand("list", "micromanip device list")
def list_() -> Answer:
    """List the installed drivers: kind, package and version, where each comes from, what is wrong with it.

    Each is loaded and its class is looked at; nothing is opened, no hardware is needed. Exit code 1 if one of them
    can't be loaded or does not keep its contract. `loads` is no more than that: `run` compiles it, and what it does on
    its bus is for its author's conformance tests to show (docs/write-a-driver.md).
    """
    from micromanip.bus.registry import inspected

    found = inspected()
    broken = [driver.name for driver in found if driver.problems]
    unusable = CheckFailed(f"{'driver' if len(broken) == 1 else 'drivers'} {', '.join(broken)} can't be used")
    document = {"drivers": [{**asdict(driver), "ok": not driver.problems} for driver in found]}
    return Answer(document, lambda: _print_drivers(found), unusable if broken else None)


def _print_drivers(found: list[Inspected]) -> None:
    if not found:
        echo("no driver is installed: install the package of one into this environment (docs/write-a-driver.md)")
    width = max((len(driver.name) for driver in found), default=0)
    for driver in found:
        verdict = "BROKEN" if driver.problems else "loads"
        echo(f"{driver.name:{width}}  {driver.kind or '?':6}  {verdict:6}  {driver.package} {driver.version}")
        echo(f"{'':{width}}  {driver.entry_point}{f' in {driver.file}' if driver.file else ''}")
        for problem in driver.problems:
            echo(f"{'':{width}}  {problem}")


@subcommand("probe", "micromanip device probe config/can.yaml can0 --seconds 5")
@config_argument
@click.argument("driver", metavar="DRIVER")
@click.option("--seconds", type=Quantity("Seconds", least=0.1, most=3600.0), default=2.0, help="How long to look.")
def probe(config: Path, driver: str, seconds: float) -> Answer:
    """Show what answers on the bus of DRIVER, as CONFIG names it, with live values; nothing is moved.

    Refused (exit code 69) while a controller has the device, and where no value can be read, whatever else answers.
    Ctrl-C ends it early.
    """
    from micromanip.bus.device_lock import DeviceLocks
    from micromanip.bus.driver import BusDriver
    from micromanip.settings.wiring.single_driver import driver_to_probe

    chosen = driver_to_probe(config, driver)
    if type(chosen).probe is BusDriver.probe:
        raise UsageError(f"driver {driver} has no probe: what answers on its bus can't be seen without moving it")
    with DeviceLocks(_devices(chosen)):
        answers: dict[str, Found] = {}
        told_values: set[str] = set()
        with contextlib.suppress(KeyboardInterrupt):
            _look(chosen, seconds, answers, told_values, live=sys.stdout.isatty() and not wants_json())
    found = [_document(answer) for answer in answers.values()]
    document = {"driver": driver, "device": _device(chosen), "seconds": seconds, "answers": found}
    silent = DeviceUnavailable(_why(answers, f"{_device(chosen)} in {seconds:g} s", f"drivers.{driver}"))
    return Answer(document, lambda: _show(answers), None if told_values else silent)


def _why(answers: dict[str, Found], where: str, section: str) -> str:
    """What to say where no value was read: an exception that is answered, or silence, is none."""
    if not answers:
        return f"nothing answered on {where}; check power, cable and the keys of {section}"
    first, *others = answers.values()
    more = f" (and {len(others)} more)" if others else ""
    return f"no value was read on {where}: {first.name}: {first.note}{more}; check the device and the keys of {section}"


def _device(driver: BusDriver | CyclicDriver) -> str:
    return driver.device or type(driver).__name__


def _devices(driver: BusDriver | CyclicDriver) -> tuple[str, ...]:
    """All that nobody else may have meanwhile."""
    from micromanip.bus.driver import BusDriver

    owned = (driver.device,) if isinstance(driver, BusDriver) else driver.devices
    return owned or (_device(driver),)


def _look(
    driver: BusDriver | CyclicDriver, seconds: float, answers: dict[str, Found], told_values: set[str], live: bool
) -> None:
    """Gather the newest answer of each name into `answers`, on a terminal in a table that follows them.

    Those that were a value at least once are in `told_values`: on a noisy line the newest may be none.
    """
    from micromanip.bus.driver import BusDriver

    try:
        with _shown_live(answers) if live else contextlib.nullcontext() as view:
            for answer in _found(driver, seconds):
                answers[answer.name] = answer
                if answer.is_value:
                    told_values.add(answer.name)
                if view is not None:
                    view.update(_table(answers))
    finally:
        if isinstance(driver, BusDriver):
            driver.close()


def _shown_live(answers: dict[str, Found]) -> Live:
    from rich.live import Live

    return Live(_table(answers), refresh_per_second=5)


def _found(driver: BusDriver | CyclicDriver, seconds: float) -> Iterator[Found]:
    from micromanip.bus.errors import BusError

    try:
        yield from driver.probe(seconds)
    except BusError as problem:
        said = str(problem)
        named = said.startswith(_device(driver))  # most errors of a bus begin with its name
        raise DeviceUnavailable(said if named else f"{_device(driver)}: {said}") from problem


def _rows(answers: dict[str, Found]) -> Iterator[tuple[str, str, str, str]]:
    for answer in answers.values():
        values = [(str(name), _shown(value)) for name, value in answer.values.items()] or [("", "")]
        for number, (name, value) in enumerate(values):
            yield ("", name, value, "") if number else (answer.name, name, value, answer.note)


def _table(answers: dict[str, Found]) -> Table:
    from rich.text import Text

    from .tables import Figures

    table = Figures("answers", "name", "value", "note")
    for row in _rows(answers):
        table.add_row(*map(Text, row))
    return table


def _show(answers: dict[str, Found]) -> None:
    """What a terminal has been shown already."""
    from .tables import out_console

    if answers and not sys.stdout.isatty():
        out_console().print(_table(answers))


def _shown(value: Any) -> str:
    return f"{value:.6g}" if isinstance(value, float) else str(value)


def _document(answer: Found) -> dict[str, Any]:
    plain = (str, int, float, bool, list, tuple, dict, type(None))
    values = {str(name): value if isinstance(value, plain) else str(value) for name, value in answer.values.items()}
    return {"name": answer.name, "values": values, "note": answer.note, "is_value": answer.is_value}
