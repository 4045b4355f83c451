"""What was valid when a controller last ran: a copy of its configuration, for ``park``.

The daemon writes it once its drivers are up, and again where a change concerns the outputs. It lies in the state
directory, named for the configuration's real path, and is believed only where nobody else can have written it. The
files that the drivers have read besides, message databases, are in it as they were: whatever has become of them does
not change what is sent (``docs/decisions/0020-park-from-a-snapshot.md``).
"""

from __future__ import annotations

import asyncio
import base64
import contextlib
import hashlib
import json
import os
import re
import stat
import tempfile
import time
import zlib
from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from micromanip.files import HeldFolder, open_regular
from micromanip.host.control.request import is_deeper
from micromanip.settings.check import Prepared
from micromanip.settings.text.source import Source

_FOLDER, _FORMAT = "park", 2
_MOST_BYTES, _MOST_FILE_BYTES = 32_000_000, 20_000_000
_DEEPEST = 50
_CONCERNS = ("schema_version", "loop", "start", "drivers", "outputs", "switches")


class NotUsable(Exception):  # noqa: N818
    """A snapshot that is there and can't be believed; its text says why."""


@dataclass(frozen=True)
class Snapshot:
    """A configuration as it was in force."""

    taken: str
    """UTC, ISO 8601, by a clock that may have been wrong."""
    source: Source
    file: Path
    files: Mapping[str, bytes]
    """What the drivers' files held, by their absolute path."""
    order: tuple[int, ...]
    """The greatest is the newest: of this start of the machine by the time since it, of one before by the run."""

    @contextlib.contextmanager
    def restored(self) -> Iterator[Source]:
        """The configuration, with the drivers' files as they were, in a folder of one's own for so long."""
        with tempfile.TemporaryDirectory(prefix="micromanip-park-") as folder:
            places: dict[str, str] = {}
            for number, (name, content) in enumerate(self.files.items()):
                place = Path(folder) / str(number) / Path(name).name
                place.parent.mkdir()
                place.write_bytes(content)
                places[name] = str(place)
            drivers = _moved(self.source.data.get("drivers"), self.source.path.parent, places)
            yield Source.of({**self.source.data, "drivers": drivers}, self.source.path)


def _moved(value: Any, folder: Path, places: Mapping[str, str]) -> Any:
    """`value` with each name of a file, as seen from `folder`, in its new place."""
    if isinstance(value, dict):
        return {key: _moved(each, folder, places) for key, each in value.items()}
    if isinstance(value, list):
        return [_moved(each, folder, places) for each in value]
    if isinstance(value, str) and "\0" not in value:
        return places.get(os.path.abspath(folder / value), value)  # noqa: PTH100 (links stay links)
    return value


def path_of(config: Path, folder: Path) -> Path:
    """Where the snapshot of `config` lies in the state directory `folder`."""
    real = os.path.realpath(config)
    stem = re.sub(r"[^A-Za-z0-9.-]", "_", Path(real).stem)[:60]
    return folder / _FOLDER / f"{stem}-{hashlib.sha256(real.encode()).hexdigest()[:16]}.json"


def read(config: Path, folder: Path, owners: Collection[int]) -> Snapshot | None:
    """The snapshot of `config` in the state directory `folder`, None where there is none.

    Raises NotUsable where it is not one of `owners`, or others can write it, or it has been damaged or overtaken.
    """
    path = path_of(config, folder)
    try:
        document = json.loads(_content(path, owners))
        if document["format"] != _FORMAT or document["configuration"] != os.path.realpath(config):
            raise NotUsable(f"{path} is not a snapshot of {config}")
        if is_deeper(document, _DEEPEST):
            raise NotUsable(f"{path} is damaged")
        source = Source.of(document["document"], Path(document["path"]))
        files = {name: _unpacked(text) for name, text in document["files"].items()}
        since_ns = int(document["since_ns"]) if document["boot"] == _boot() else -1
        order = (since_ns, int(document["run"]))
        return Snapshot(str(document["taken"]), source, path, files, order)
    except FileNotFoundError:
        return None
    except OSError as problem:
        raise NotUsable(f"{path} can't be read: {problem.strerror}") from problem
    except (ValueError, TypeError, KeyError, AttributeError, RecursionError, zlib.error) as problem:
        raise NotUsable(f"{path} is damaged") from problem


def write(source: Source, files: Mapping[str, bytes], folder: Path) -> None:
    """Put the snapshot of `source` in place, whole or not at all, and on the disk. Raises OSError, NotUsable.

    `files` are the contents of the drivers' files by their absolute path.
    """
    path = path_of(source.path, folder)
    document = {
        "format": _FORMAT,
        "run": _newest_run(source.path, folder) + 1,
        "boot": _boot(),
        "since_ns": time.clock_gettime_ns(time.CLOCK_BOOTTIME),
        "taken": datetime.now(UTC).isoformat(timespec="milliseconds").replace("+00:00", "Z"),
        "configuration": os.path.realpath(source.path),
        "path": os.path.abspath(source.path),  # noqa: PTH100 (a link's own folder is where its files are seen from)
        "files": {name: base64.b64encode(zlib.compress(content)).decode() for name, content in files.items()},
        "document": source.data,
    }
    folder.mkdir(parents=True, exist_ok=True)
    with contextlib.suppress(FileExistsError):
        path.parent.mkdir(mode=0o750)
    with HeldFolder(path.parent, below=folder) as held:
        _refuse_strangers(path.parent, held.status(), {os.geteuid()})
        held.write(path.name, json.dumps(document).encode(), 0o640)


class SnapshotService:
    """Keeps the snapshot of what runs up to date."""

    def __init__(self, prepared: Prepared, folder: Path, say: Callable[[str], None]) -> None:
        """`say` gets a warning where it can't be written: the run goes on."""
        self._folder, self._say = folder, say
        self._path = prepared.source.path
        below = self._path.parent
        files = [below / file for driver in prepared.wiring.drivers.values() for file in driver.files]
        self._unreadable: OSError | None = None
        self._files: dict[str, bytes] = {}
        try:
            self._files = {os.path.abspath(file): _held(file) for file in files}  # noqa: PTH100 (links stay links)
        except OSError as problem:
            self._unreadable = problem
        self._written: Any = None
        self._one_at_a_time = asyncio.Lock()
        self._writing: set[asyncio.Task[None]] = set()

    async def keep(self, source: Source) -> None:
        """`source` is what runs."""
        async with self._one_at_a_time:
            concerns = [source.data.get(key) for key in _CONCERNS]
            if concerns == self._written:
                return
            try:
                if self._unreadable is not None:
                    raise self._unreadable
                await asyncio.to_thread(write, source, self._files, self._folder)
                self._written = concerns
            except (OSError, NotUsable) as problem:
                why = problem.strerror if isinstance(problem, OSError) else problem
                self._say(
                    f"WARNING: no snapshot for `micromanip park` in {self._folder}: {why}; it will go by an "
                    f"older one, or by {self._path} as it is then"
                )

    def follow(self, source: Source) -> None:
        """The same, without waiting for the disk."""
        task = asyncio.get_running_loop().create_task(self.keep(source))
        self._writing.add(task)
        task.add_done_callback(self._writing.discard)

    async def settle(self) -> None:
        """Wait until what was asked for has been written."""
        await asyncio.gather(*self._writing)


def _held(file: Path) -> bytes:
    """What a file holds. Raises OSError."""
    with open_regular(file, _MOST_FILE_BYTES) as stream:
        return stream.read(_MOST_FILE_BYTES)


def _unpacked(text: str) -> bytes:
    """Raises ValueError, zlib.error."""
    unpacking = zlib.decompressobj()
    content = unpacking.decompress(base64.b64decode(text, validate=True), _MOST_FILE_BYTES + 1)
    if len(content) > _MOST_FILE_BYTES or not unpacking.eof:
        raise ValueError
    return content


def _boot() -> str:
    """Which start of the machine this is."""
    return Path("/proc/sys/kernel/random/boot_id").read_text(encoding="ascii").strip()


def _newest_run(config: Path, folder: Path) -> int:
    """Number of the last run with `config` that left a snapshot here; 0 where there is none."""
    try:
        before = read(config, folder, {os.geteuid()})
    except NotUsable:
        return 0
    return 0 if before is None else before.order[-1]


def _content(path: Path, owners: Collection[int]) -> bytes:
    """Raises OSError, NotUsable."""
    at = _opened_folder(path.parent, owners)
    try:
        descriptor = os.open(path.name, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC, dir_fd=at)
    finally:
        os.close(at)
    with open(descriptor, "rb") as stream:  # noqa: PTH123 (of a descriptor)
        found = os.fstat(descriptor)
        if not stat.S_ISREG(found.st_mode) or found.st_nlink != 1:
            raise NotUsable(f"{path} is no plain file")
        _refuse_strangers(path, found, owners)
        content = stream.read(_MOST_BYTES + 1)
    if len(content) > _MOST_BYTES:
        raise NotUsable(f"{path} is larger than {_MOST_BYTES // 1_000_000} MB")
    return content


def _opened_folder(folder: Path, owners: Collection[int]) -> int:
    """A descriptor of a folder in which nobody else writes. Raises OSError, NotUsable."""
    descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW | os.O_CLOEXEC)
    try:
        _refuse_strangers(folder, os.fstat(descriptor), owners)
    except NotUsable:
        os.close(descriptor)
        raise
    return descriptor


def _refuse_strangers(path: Path, found: os.stat_result, owners: Collection[int]) -> None:
    if found.st_uid not in owners:
        raise NotUsable(f"{path} belongs to user {found.st_uid}")
    if found.st_mode & (stat.S_IWGRP | stat.S_IWOTH):
        raise NotUsable(f"{path} can be written by others")
