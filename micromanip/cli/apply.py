"""``micromanip apply``: put a tuned file in force where the cell runs, or the old one back in its place."""

from __future__ import annotations

import datetime
import subprocess
import time
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from micromanip.client import Client
from micromanip.errors import CheckFailed, ConfigError, MicromanipError, PermissionDenied, UsageError, system_error

from .echo import echo
from .options import Answer, socket_option, subcommand
from .parameters import brief

if TYPE_CHECKING:
    from micromanip.settings.check import Prepared

_BACKUP = "before"
_PATIENCE_S, _LOOK_S = 180.0, 0.1
_STARTING = ("OFF", "STARTING")
_AT_REST = ("READY", "FAULT")


@subcommand("apply", "micromanip apply tuned/tuned.yaml --service micromanip")
@click.argument("tuned", type=click.Path(path_type=Path), required=False)
@click.option("--service", metavar="UNIT", help="Unit of systemd to start anew where a change needs that.")
@click.option("--back", is_flag=True, help="Put back the file that the last `apply` replaced.")
@click.option("--yes", is_flag=True, help="Don't ask.")
@socket_option
def command(tuned: Path | None, service: str | None, back: bool, yes: bool, socket_path: Path) -> Answer:
    """Put TUNED in the place of the file that the running controller was started with.

    Shows what changes, and asks. The file before is kept beside it. Where every change may be made while it runs, the
    controller takes it over; else the service is started anew, with the outputs at rest. The old file comes back where
    the controller does not run with the new one by then, exit code 1.
    """
    from micromanip.settings.check import prepared
    from micromanip.settings.text.source import Source

    if back == (tuned is not None):
        raise UsageError("name the file to apply, or --back: one of them")
    with Client(socket_path) as client:
        status = client.status()
        running = client.configuration()["text"]
        file = _running_file(Path(status["configuration"]), running)
    before = prepared(Source.parse(file, running))
    new = _newest_backup(file) if tuned is None else tuned
    # as it will be read in its new place: what it names lies beside it there
    text = Source.read(new).text
    try:
        after = prepared(Source.parse(file, text))
    except ConfigError as problem:
        raise ConfigError(str(problem).replace(f"{file}:", f"{new}:")) from problem
    changed, restarts = _changes(before, after)
    for each in changed:
        echo(f"  {each['key']}: {brief(each['running'])} -> {brief(each['new'])}  ({each['change']})", err=True)
    applied = Applied(file, after, socket_path, service if restarts else None)
    if changed:
        _require(changed, restarts, status["state"], service)
        if not yes:
            click.confirm(f"{len(changed)} values of {file} change. Apply them?", abort=True, err=True)
        applied.apply()
    outcome = {"file": str(file), "before": str(applied.backup) if changed else None, "changed": changed}
    said = f"{file} is in force; what was before is {applied.backup} (`micromanip apply --back`)"
    return Answer(outcome, lambda: echo(said if changed else f"nothing to do: {file} runs with all values of {new}"))


def _changes(before: Prepared, after: Prepared) -> tuple[list[dict[str, Any]], bool]:
    """What changes, for people, and whether it takes a new start."""
    from micromanip.settings.change import ABSENT, changed, demands
    from micromanip.settings.schema.key import LIVE, RESTART
    from micromanip.settings.text.source import key_text

    takes = demands(before.configuration, after.configuration)
    listed = [
        {
            "key": key_text(path),
            "running": None if old is ABSENT else old,
            "new": None if new is ABSENT else new,
            "change": takes.get(path, LIVE),
        }
        for path, (old, new) in changed(before.configuration, after.configuration).items()
        if any(each is not None and each is not ABSENT for each in (old, new))  # a section is told by its keys
    ]
    return listed, any(each["change"] == RESTART for each in listed)


def _require(changed: list[dict[str, Any]], restarts: bool, state: str, service: str | None) -> None:
    """Raises where the change can't be made now."""
    from micromanip.settings.schema.key import LIVE

    if restarts and service is None:
        raise UsageError("some of it takes a new start: name the unit, such as --service micromanip")
    if state not in _AT_REST and any(each["change"] != LIVE for each in changed):
        raise CheckFailed(f"some of it takes outputs at rest, and the cell is {state}: `micromanip disarm` first")


def _running_file(file: Path, text: str) -> Path:
    """Where the controller has its file, which it may name as it is seen from another folder than this."""
    if file.is_absolute() or (file.is_file() and file.read_text(encoding="utf-8") == text):
        return file.absolute()
    raise UsageError(
        f"the controller was started with {file}, seen from a folder of its own: call `apply` there, or start it with "
        "an absolute path"
    )


def _newest_backup(file: Path) -> Path:
    found = sorted(file.parent.glob(f"{file.stem}.{_BACKUP}-*{file.suffix}"))
    if not found:
        raise UsageError(f"nothing to put back: no {file.stem}.{_BACKUP}-...{file.suffix} beside {file}")
    return found[-1]


@dataclass
class Applied:
    """A new configuration in the place of `file`; with a `service` that is started anew, else by a reload."""

    file: Path
    new: Prepared
    socket: Path
    service: str | None
    backup: Path = Path()

    def apply(self) -> None:
        """Write it and put it in force. Raises CheckFailed with the old one back in its place, PermissionDenied."""
        old = self.file.read_text(encoding="utf-8")
        now = f"{datetime.datetime.now(datetime.UTC):%Y%m%dT%H%M%S.%fZ}"
        self.backup = self.file.with_name(f"{self.file.stem}.{_BACKUP}-{now}{self.file.suffix}")
        self._write(self.backup, old)
        self._write(self.file, self.new.source.text)
        try:
            self._in_force()
            self._await(self.new.source.hash)
        except MicromanipError as problem:
            raise CheckFailed(f"{str(problem).rstrip('.')}. {self._back(old)}") from problem
        except BaseException:  # Ctrl-C while it is waited for
            echo(self._back(old), err=True)
            raise

    def _back(self, old: str) -> str:
        """Put the old file back in its place and in force; what came of it, in words."""
        self._write(self.file, old)
        self.backup.unlink()
        try:
            self._in_force()
        except MicromanipError as problem:
            return f"{self.file} is as it was, but could not be put in force again: {problem}"
        return f"{self.file} is as it was"

    def _write(self, file: Path, text: str) -> None:
        from micromanip.settings.write import write_atomically

        try:
            write_atomically(file, text)
            if file != self.file:
                file.chmod(self.file.stat().st_mode & 0o777)
        except PermissionError as problem:
            raise PermissionDenied(f"{file} may not be written: {problem.strerror}") from problem
        except OSError as problem:
            raise system_error(problem) from problem

    def _in_force(self) -> None:
        if self.service is None:
            with Client(self.socket) as client:
                client.reload()
            return
        done = subprocess.run(["systemctl", "restart", self.service], capture_output=True, text=True, check=False)
        if done.returncode != 0:
            raise CheckFailed(f"systemctl restart {self.service} failed: {done.stderr.strip() or done.returncode}")

    def _await(self, sha256: str) -> None:
        """Until the controller runs with that text. Raises CheckFailed."""
        end_s = time.monotonic() + _PATIENCE_S
        while (problem := self._obstacle(sha256)) is not None and time.monotonic() < end_s:
            time.sleep(_LOOK_S)
        if problem is not None:
            raise CheckFailed(f"the controller does not run with it after {_PATIENCE_S:g} s: {problem}")

    def _obstacle(self, sha256: str) -> str | None:
        try:
            with Client(self.socket) as client:
                status = client.status()
        except MicromanipError as problem:
            return str(problem)
        if status["state"] in _STARTING or (self.service is not None and status["state"] == "FAULT"):
            return f"it is {status['state']}"
        return None if status["configuration_sha256"] == sha256 else "another configuration runs"
