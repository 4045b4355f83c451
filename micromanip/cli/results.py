"""Where a command puts its results: a folder that is tried before anything moves.

A page of the same name is written anew. What somebody has changed of an earlier commissioning is set aside, into a
folder named for when it was written; a file that another folder beside it holds already, byte for byte, is replaced.
"""

from __future__ import annotations

import contextlib
import datetime
import filecmp
import itertools
import os
import shutil
import tempfile
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from micromanip.errors import MicromanipError, UsageError, system_error

from .echo import echo

if TYPE_CHECKING:
    from micromanip.design.report.model import Section
    from micromanip.settings.check import Prepared

LATEST = "latest"
_ROOM_BYTES = 16_000_000
_PAGES = (".html", ".htm")


def out_option(contents: str, **how: Any) -> Callable[[Any], Any]:
    """``--out``, for a folder; `contents` is its help."""
    return click.option(
        "--out", "folder", type=click.Path(path_type=Path, file_okay=False), help=f"Folder for {contents}.", **how
    )


def require_room(folder: Path, what: str) -> None:
    """Raise where `folder` has no room for a large result; `what` is the option that names it."""
    try:
        with tempfile.TemporaryFile(dir=folder) as probe:
            os.posix_fallocate(probe.fileno(), 0, _ROOM_BYTES)
    except OSError as problem:
        raise system_error(problem, what) from problem


@contextlib.contextmanager
def results_folder(folder: Path) -> Iterator[None]:
    """`folder` is there and takes files, or an error is raised; one made for nothing is removed again."""
    made = [each for each in (folder, *folder.parents) if not each.exists()]
    try:
        try:
            folder.mkdir(parents=True, exist_ok=True)
        except OSError as problem:
            raise system_error(problem, f"--out {folder}") from problem
        require_room(folder, f"--out {folder}")
        yield
    finally:
        for each in made:
            with contextlib.suppress(OSError):  # there is something in it
                each.rmdir()


def require_new(place: Path, option: str) -> None:
    """Raise UsageError where there is a file already; `option` is the one that names another."""
    if place.is_symlink() or place.exists():
        raise UsageError(f"{place} is there already: nothing is replaced; name another file with {option}")


def require_new_page(place: Path) -> None:
    """Raise where no page can be written to `place`, or nobody would open it as one: before anything is read for it."""
    if place.suffix.lower() not in _PAGES:
        raise UsageError(f"--to {place}: a page is HTML: name a file that ends with .html")
    require_new(place, "--to")
    require_room(place.parent, str(place))


def provenance(prepared: Prepared, axis: str, seed: int | None) -> str:
    """What a page says of where it comes from; `seed` None stands for that of the simulation in the file."""
    drivers = prepared.configuration.drivers.values()
    seeds = [driver.options.get("seed", 1) for driver in drivers if driver.driver == "simulated"]
    drawn = "".join(f", seed {each}" for each in (seeds[:1] if seed is None else [seed]))
    today = datetime.datetime.now(datetime.UTC).date().isoformat()
    return f"axis {axis}, {prepared.source.path} ({prepared.source.hash[:8]}), {today}{drawn}"


class Page:
    """One page of HTML of what a command has found, whole or not there.

    A disk that fills keeps the command's other results: `problem` says then what is missing.
    """

    def __init__(self, file: Path | None) -> None:
        """None: no page is wanted."""
        self.file = file
        self.problem: MicromanipError | None = None

    def write(self, title: str, sections: Iterable[Section]) -> None:
        """Draw `sections`, which are asked for only where a page is wanted."""
        if self.file is None:
            return
        from micromanip.design.report.page import page_of

        text, new = page_of(title, sections), self.file.with_name(f".{self.file.name}")
        try:
            new.write_text(text, encoding="utf-8")
            new.replace(self.file)
        except OSError as problem:
            new.unlink(missing_ok=True)
            cause = system_error(problem, str(self.file))
            self.file, self.problem = None, type(cause)(f"the page is not written: {cause}")

    @property
    def name(self) -> str | None:
        """The file, as JSON has it."""
        return None if self.file is None else str(self.file)

    def echo(self) -> None:
        """Say what is there."""
        if self.file is not None:
            echo(f"wrote {self.file}")


@contextlib.contextmanager
def page_in(folder: Path | None, name: str) -> Iterator[Page]:
    """The page `name` of `folder`, which is tried at the beginning; None: nothing is drawn."""
    with contextlib.nullcontext() if folder is None else results_folder(folder):
        yield Page(None if folder is None else folder / name)


@contextlib.contextmanager
def run_folder(folder: Path, label: str, wanted: str) -> Iterator[Path]:
    """A new folder in `folder`, named for the present time (UTC) and `label`; it stays where it then holds `wanted`."""
    run = _new_folder(folder, datetime.datetime.now(datetime.UTC), label)
    try:
        yield run
    finally:
        if not (run / wanted).exists():
            shutil.rmtree(run, ignore_errors=True)


def publish(folder: Path, run: Path, names: Iterable[str]) -> None:
    """Copies of the files `names` of `run`, in that order, in `folder` itself, and `latest` beside them.

    One that this run lacks is no longer there. Raises OSError.
    """
    files = {name: run / name for name in names}
    set_aside(folder, files)
    for name, file in files.items():
        if not file.exists():
            (folder / name).unlink(missing_ok=True)
            continue
        copy = folder / f".{name}-{run.name}"
        try:
            shutil.copy(file, copy)
            copy.replace(folder / name)
        finally:
            copy.unlink(missing_ok=True)
    link = folder / f".{LATEST}-{run.name}"
    try:
        link.symlink_to(run.name, target_is_directory=True)
    except OSError:  # a file system without links
        link.write_text(f"{run.name}\n", encoding="utf-8")
    link.replace(folder / LATEST)


def set_aside(folder: Path, coming: dict[str, Path]) -> Path | None:
    """Make way in `folder` for the files `coming`, by name; the folder that took what was there before, if any."""
    older = [folder / name for name in coming if (folder / name).is_symlink() or (folder / name).exists()]
    lost = [file for file in older if not _kept(file, [coming[file.name], *folder.glob(f"[0-9]*/{file.name}")])]
    if not lost:
        return None
    written = max(file.lstat().st_mtime for file in lost)
    aside = _new_folder(folder, datetime.datetime.fromtimestamp(written, datetime.UTC), "earlier")
    for file in lost:
        file.rename(aside / file.name)
    return aside


def _kept(file: Path, others: Iterable[Path]) -> bool:
    return file.is_file() and any(other.is_file() and filecmp.cmp(file, other, shallow=False) for other in others)


def _new_folder(folder: Path, at: datetime.datetime, label: str) -> Path:
    for number in itertools.count(1):
        new = folder / f"{at:%Y-%m-%dT%H%M%SZ}-{label}{'' if number == 1 else f'-{number}'}"
        with contextlib.suppress(FileExistsError):
            new.mkdir()
            return new
    raise AssertionError
