"""``micromanip status``: what the running controller does."""

from __future__ import annotations

import contextlib
import sys
import time
from pathlib import Path

import click

from micromanip.client import Client
from micromanip.errors import DeviceUnavailable, UsageError

from .options import Quantity, StrictCommand, json_option, print_json, socket_option
from .prose import say

_REFRESH_S = 0.2


@click.command("status", cls=StrictCommand, epilog="Example: micromanip status --watch")
@click.option("--watch", is_flag=True, help="Go on until Ctrl-C: a live view on a terminal, a line a time elsewhere.")
@click.option(
    "--every", "every_s", type=Quantity("Seconds", least=0.1), default=2.0, show_default=True, help="Seconds a line."
)
@socket_option
@json_option
def command(watch: bool, every_s: float, socket_path: Path, as_json: bool) -> None:
    """What the running controller does: its state, what each axis does, its timing and path error.

    Where it keeps a trend, also how old its newest row is, and the path error of the last 24 hours. Where no controller
    answers, that is told of the newest trend that is known here.
    """
    if watch and as_json:
        raise UsageError("--watch goes on and --json is one document: use one of them")
    with _connected(socket_path) as client:
        if watch:
            with contextlib.suppress(KeyboardInterrupt):
                _watch(client, every_s)
            return
        report = client.status()
    kept = report.get("trend")  # a controller of an older version has not heard of it
    if as_json:
        from .kept_trend import with_last_day

        print_json(report if kept is None else {**report, "trend": with_last_day(kept)})
        return
    from .live import status

    status(report)
    if kept is not None:
        from .kept_trend import told
        from .tables import out_console

        out_console().print(told(kept), highlight=False, markup=False, style="bold red" if kept["message"] else "")


def _connected(socket_path: Path) -> Client:
    try:
        return Client(socket_path)
    except DeviceUnavailable as problem:
        from .kept_trend import told_of_the_last

        last = told_of_the_last()
        raise problem if last is None else DeviceUnavailable(f"{problem}; {last}") from None


def _watch(client: Client, every_s: float) -> None:
    """Show the status again and again, until the controller goes away."""
    from rich.live import Live

    from .live import one_line, watched

    if not sys.stdout.isatty():
        while True:
            report = client.status()
            say(f"{report['state']:9}{one_line(report)}")
            time.sleep(every_s)
    with Live(watched(client.status()), refresh_per_second=5, screen=True) as view:
        while True:
            time.sleep(_REFRESH_S)
            view.update(watched(client.status()))
