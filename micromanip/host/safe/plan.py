"""What ``park`` goes by: the snapshot of the last run, else a file that would be let run, else nothing."""

from __future__ import annotations

import os
import stat
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

from micromanip.errors import ConfigError
from micromanip.host.service.layout import STATE
from micromanip.host.state_directory import state_directory
from micromanip.settings.check import prepare, wired
from micromanip.settings.schema.model import Configuration
from micromanip.settings.wiring.places import Wiring

from .snapshot import NotUsable, Snapshot, read

SERVICE_STATE = STATE[0]


@dataclass(frozen=True)
class SafePlan:
    """A configuration that was checked, and where it is from."""

    configuration: Configuration
    wiring: Wiring
    file: Path
    taken: str | None
    """When the snapshot was taken (UTC, ISO 8601); None for the configuration's own file."""
    warnings: list[str] = field(default_factory=list)
    """Why what would have been better was not used."""

    @property
    def said(self) -> str:
        """Where it is from, in words."""
        return f"from {self.file}" if self.taken is None else f"as of the run of {self.taken} ({self.file})"


def plan_of(config: Path, *, from_file: bool = False) -> SafePlan:
    """What is safe for the outputs of `config`; `from_file` passes over what a run has left.

    Raises ConfigError where neither a snapshot nor the file can be used: then nothing may be written to any device.
    """
    warnings: list[str] = []
    for snapshot in [] if from_file else _snapshots(config, warnings):
        try:
            with snapshot.restored() as source:
                configuration, wiring = wired(source)
        except ConfigError as problem:
            warnings.append(f"{snapshot.file} is not valid any more: {problem}")
        else:
            return SafePlan(configuration, wiring, snapshot.file, snapshot.taken, warnings)
    try:
        prepared = prepare(config)
    except ConfigError as problem:
        why = "; ".join(warnings) or "there is none"
        raise ConfigError(
            f"{problem}\n"
            f"nothing was touched: the file can't be used, and no run has left a snapshot that can be ({why}); see to "
            f"it that the outputs are safe by other means, mend the file (`micromanip check {config}`) and try again"
        ) from problem
    return SafePlan(prepared.configuration, prepared.wiring, config, None, warnings)


def _snapshots(config: Path, warnings: list[str]) -> list[Snapshot]:
    """Those that can be believed, the newest first."""
    found = []
    for folder, owners in _places():
        try:
            snapshot = read(config, folder, owners)
        except NotUsable as problem:
            warnings.append(str(problem))
        else:
            found += [snapshot] if snapshot is not None else []
    return sorted(found, key=lambda snapshot: snapshot.order, reverse=True)


def _places() -> Iterator[tuple[Path, set[int]]]:
    """State directories, and whose snapshots in them are believed: one's own, root's, and in its own the service's.

    The service writes to the same devices anyway; who can take its place there is root alone.
    """
    ours = {0, os.geteuid()}
    own = state_directory()
    yield own, ours
    if own == SERVICE_STATE:
        return
    try:
        found, above = SERVICE_STATE.lstat(), SERVICE_STATE.parent.stat()
    except OSError:
        return
    if stat.S_ISDIR(found.st_mode) and above.st_uid == 0 and not above.st_mode & (stat.S_IWGRP | stat.S_IWOTH):
        yield SERVICE_STATE, {*ours, found.st_uid}
