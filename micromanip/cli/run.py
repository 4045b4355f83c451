"""``micromanip run``: the daemon, with a live line and a summary at the end."""

from __future__ import annotations

import gc
import signal
from pathlib import Path
from typing import Any

import click

from micromanip.errors import CheckFailed
from micromanip.status_reply import Status

from .options import Answer, Quantity, config_argument, socket_option, subcommand


@subcommand("run", "micromanip run config/simulated.yaml --duration 10")
@config_argument
@click.option(
    "--duration",
    "duration_s",
    type=Quantity("Duration"),
    help="Stop cleanly so many seconds after READY; where arm_on_start arms, after that. What comes before does not "
    "count.",
)
@click.option("--record", type=click.Path(path_type=Path), help="Record every cycle to this new file, .mcap.")
@click.option(
    "--recordings",
    type=click.Path(path_type=Path, file_okay=False),
    help="Folder for what `recording start` records.  [default: $STATE_DIRECTORY/recordings, or the user's own]",
)
@click.option(
    "--trips",
    type=click.Path(path_type=Path, file_okay=False),
    help="Folder for the black box of each trip.  [default: $STATE_DIRECTORY/trips, or the user's own]",
)
@click.option("--keep-trips", type=Quantity("Count"), default=50, help="So many of them, the newest.")
@socket_option
def command(
    config: Path,
    duration_s: float | None,
    record: Path | None,
    recordings: Path | None,
    trips: Path | None,
    keep_trips: int,
    socket_path: Path,
) -> Answer:
    """Run the controller. It ends in READY and waits for `micromanip arm`, unless arm_on_start is set.

    Ctrl-C ramps the outputs to park and stops cleanly.
    """
    import asyncio

    from micromanip.errors import UsageError
    from micromanip.rt.jit import PLAIN

    if PLAIN:
        raise UsageError(
            "NUMBA_DISABLE_JIT is set: as plain Python the loop keeps no deadline; unset it, or use replay"
        )

    report = asyncio.run(_run(config, socket_path, duration_s, record, recordings, trips, keep_trips))
    from .live import summary

    return Answer(report, lambda: summary(report), _failure(report))


async def _run(config: Path, socket_path: Path, duration_s: float | None, record: Path | None, *files: Any) -> Status:
    """The loop process begins at once: it imports while this one imports, reads the configuration and checks it."""
    from micromanip.host.child import loop_process

    process, asked = loop_process(), []

    def interrupted(*_: Any) -> None:
        asked.append(True)
        raise KeyboardInterrupt

    await process.begin()
    if callable(signal.getsignal(signal.SIGINT)):  # asyncio's, which would wait until all this is done
        signal.signal(signal.SIGINT, interrupted)
    try:
        gc.disable()  # of all that is imported nothing is garbage: looking for it takes a tenth of the start
        try:
            from micromanip.host.daemon import Options, served
            from micromanip.host.recording.recording import require_new_file
            from micromanip.settings.check import prepare

            from .live import LiveLine

            prepared = prepare(config)
        finally:
            gc.enable()
        if asked:  # an exception that is raised while modules are made is lost now and then, and nothing may move then
            raise KeyboardInterrupt
        if record is not None:
            require_new_file(record)
        options = Options(socket_path, duration_s, record, *files)
        with LiveLine() as live:
            return await served(prepared, options, live.say, live.show, process)
    finally:
        # what asyncio lets go of ends a process: a reload that comes too late would take the report away
        signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGHUP])
        await process.let_go()


def _failure(report: Status) -> CheckFailed | None:
    if report["fault_reports"]:  # in full where it was noticed
        names = [
            fault["code"] + (f" on axis {fault['axis']}" if fault["axis"] else "") for fault in report["fault_reports"]
        ]
        return CheckFailed(
            f"ended by {' after '.join(reversed(names))}, as said above; `micromanip trip show` shows more"
        )
    if report["recording"] is not None and report["recording"]["message"] is not None:
        return CheckFailed(report["recording"]["message"])
    return None
