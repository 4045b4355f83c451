"""Where a command puts its results: a folder that is tried before anything moves, and where nothing is replaced.

What an earlier run has left under the same name is set aside, into a folder named for when it was written; only a file
that another folder beside it holds already, byte for byte, is replaced.
"""

from __future__ import annotations

import contextlib
import datetime
import filecmp
import itertools
import shutil
import tempfile
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from micromanip.errors import MicromanipError, UsageError, system_error

if TYPE_CHECKING:
    from micromanip.settings.check import Prepared

LATEST = "latest"
_PROBE = bytes(4096)
_PAGES = (".html", ".htm")


def out_option(contents: str, **how: Any) -> Callable[[Any], Any]:
    """``--out``, for a folder; `contents` is its help."""
    return click.option(
        "--out", "folder", type=click.Path(path_type=Path, file_okay=False), help=f"Folder for {contents}.", **how
    )


def require_room(folder: Path, what: str) -> None:
    """Raise where `folder` takes no file; `what` is the option that names it."""
    try:
        with tempfile.TemporaryFile(dir=folder) as probe:
            probe.write(_PROBE)
    except OSError as problem:
        raise system_error(problem, what) from problem


@contextlib.contextmanager
def results_folder(folder: Path, option: str = "--out") -> Iterator[None]:
    """`folder` is there and takes files, or an error is raised; one made for nothing is removed again."""
    made = [each for each in (folder, *folder.parents) if not each.exists()]
    try:
        try:
            folder.mkdir(parents=True, exist_ok=True)
        except OSError as problem:
            raise system_error(problem, f"{option} {folder}") from problem
        require_room(folder, f"{option} {folder}")
        yield
    finally:
        for each in made:
            with contextlib.suppress(OSError):  # there is something in it
                each.rmdir()


def require_new(place: Path, option: str) -> None:
    """Raise UsageError where there is a file already; `option` is the one that names another."""
    if place.is_symlink() or place.exists():
        raise _is_there(place, option)


def require_new_page(place: Path) -> None:
    """Raise where no page can be written to `place`, or nobody would open it as one: before anything is read for it."""
    if place.suffix.lower() not in _PAGES:
        raise UsageError(f"--to {place}: a page is HTML: name a file that ends with .html")
    require_new(place, "--to")
    require_room(place.parent, str(place))


def write_new_page(place: Path, text: str) -> None:
    """A page to a file that is not there yet."""
    try:
        with place.open("x", encoding="utf-8") as written:
            written.write(text)
    except FileExistsError:
        raise _is_there(place, "--to") from None
    except OSError as problem:
        raise system_error(problem, place) from problem


def _is_there(place: Path, option: str) -> UsageError:
    return UsageError(f"{place} is there already: nothing is replaced; name another file with {option}")


def provenance(prepared: Prepared, axis: str, seed: int | None) -> str:
    """What a picture says of where it comes from; `seed` None stands for that of the simulation in the file."""
    seeds = [
        driver.options.get("seed", 1)
        for driver in prepared.configuration.drivers.values()
        if driver.driver == "simulated"
    ]
    drawn = "".join(f", seed {each}" for each in (seeds[:1] if seed is None else [seed]))
    today = datetime.datetime.now(datetime.UTC).date().isoformat()
    return f"axis {axis}, {prepared.source.path} ({prepared.source.hash[:8]}), {today}{drawn}"


class Pictures:
    """Pictures drawn beside their place and put there together.

    A disk that fills keeps those that were whole, and the command's other results: `require_written` then says so.
    """

    def __init__(self, folder: Path | None, drafts: Path) -> None:
        self._folder, self._drafts = folder, drafts
        self._problem: OSError | None = None

    def draw(self, pictures: Callable[[Path], Iterable[object]], drawn: Callable[[], None] = lambda: None) -> None:
        """Let `pictures` write into the folder that it is called with, `drawn` after each; after a failure no more."""
        if self._folder is None or self._problem is not None:
            return
        try:
            for _ in pictures(self._drafts):
                drawn()
        except OSError as problem:
            self._problem = problem

    def put(self) -> list[Path]:
        """Put them where they belong; their files."""
        if self._folder is None:
            return []
        names = [file.name for file in sorted(self._drafts.iterdir(), key=lambda file: file.stat().st_mtime_ns)]
        try:
            set_aside(self._folder, {name: self._drafts / name for name in names})
            return [(self._drafts / name).replace(self._folder / name) for name in names]
        except OSError as problem:
            self._problem = self._problem or problem
            return [self._folder / name for name in names if not (self._drafts / name).exists()]

    def require_written(self) -> None:
        """Raise where a picture is missing."""
        if self._problem is not None:
            cause = system_error(self._problem, f"--out {self._folder}")
            raise type(cause)(f"the figures are not complete: {cause}") from self._problem


@contextlib.contextmanager
def pictures_in(folder: Path | None) -> Iterator[Pictures]:
    """Pictures for `folder`, which is tried at the beginning; None: nothing is drawn."""
    if folder is None:
        yield Pictures(None, Path())
        return
    with (
        results_folder(folder),
        tempfile.TemporaryDirectory(prefix=".drafts-", dir=folder, ignore_cleanup_errors=True) as drafts,
    ):
        yield Pictures(folder, Path(drafts))


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
        with tempfile.NamedTemporaryFile(dir=folder, delete=False) as copy:
            try:
                with file.open("rb") as original:
                    shutil.copyfileobj(original, copy)
                copy.flush()
                shutil.copymode(file, copy.name)
                Path(copy.name).replace(folder / name)
            except OSError:
                Path(copy.name).unlink()
                raise
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


def keep(write: Callable[[Path], object], file: Path) -> None:
    """`write(file)`; where the disk refuses it, among the temporary files, and an error that says where."""
    try:
        write(file)
    except OSError as problem:
        cause = system_error(problem, file)
        raise type(cause)(f"{cause}; {_elsewhere(write, file.name)}") from problem


def _elsewhere(write: Callable[[Path], object], name: str) -> str:
    try:
        refuge = Path(tempfile.mkdtemp(prefix="micromanip-")) / name
        write(refuge)
    except (OSError, MicromanipError):
        return "it is lost, there is no room for it anywhere"
    return f"it is kept in {refuge}"
