"""Files that others may have tampered with: regular ones only, written whole or not at all, through nobody's link.

A pipe, a device or a folder in the place of a file is refused, and nothing waits for it. A name that somebody else may
change can lead elsewhere by the time it is used: so a path is walked folder by folder, each held by a descriptor; root
follows only links of root's own, and none where it installs.
"""

from __future__ import annotations

import codecs
import contextlib
import errno
import os
import secrets
import shutil
import stat
import tempfile
from collections.abc import Iterator
from pathlib import Path
from types import TracebackType
from typing import BinaryIO, Self

from micromanip.errors import PermissionDenied

MOST_BYTES = 2_000_000_000
_FOLDER = os.O_PATH | os.O_DIRECTORY | os.O_NOFOLLOW | os.O_CLOEXEC
_NEW = os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW | os.O_CLOEXEC
_MOST_LINKS = 40
_STICKY_OR_CLOSED = "it belongs to somebody else, or others may write in it"
_MARKS = {codecs.BOM_UTF8: "utf-8-sig", codecs.BOM_UTF16_LE: "utf-16", codecs.BOM_UTF16_BE: "utf-16"}


def open_regular(file: Path, most_bytes: int = MOST_BYTES) -> BinaryIO:
    """`file`, open for reading. OSError where it can't be, isn't a regular file, or is larger than `most_bytes`."""
    _require_regular(_known_to_the_system(file).stat(), file, most_bytes)  # before it is touched: some devices react
    descriptor = os.open(file, os.O_RDONLY | os.O_NONBLOCK | os.O_NOCTTY | os.O_CLOEXEC)
    try:
        _require_regular(os.fstat(descriptor), file, most_bytes)
    except OSError:
        os.close(descriptor)
        raise
    return os.fdopen(descriptor, "rb")


def require_regular(file: Path, most_bytes: int = MOST_BYTES) -> None:
    """Raise OSError as `open_regular` does, for whoever opens the file by its name."""
    open_regular(file, most_bytes).close()


def _known_to_the_system(file: Path) -> Path:
    if "\0" in str(file):
        raise FileNotFoundError(errno.ENOENT, os.strerror(errno.ENOENT), str(file))
    return file


def _require_regular(found: os.stat_result, file: Path, most_bytes: int) -> None:
    if stat.S_ISDIR(found.st_mode):
        raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR), str(file))
    if not stat.S_ISREG(found.st_mode):
        raise OSError(errno.EINVAL, "it is not a regular file, but a pipe, a socket or a device", str(file))
    if found.st_size > most_bytes:
        raise OSError(errno.EFBIG, f"it is larger than {most_bytes / 1e6:g} MB", str(file))


def strangers(found: os.stat_result) -> str | None:
    """Why somebody else may have made it or may change it, in words; None where only root and the caller can."""
    if found.st_uid not in (0, os.geteuid()):
        return f"belongs to user {found.st_uid}"
    return "can be written by everybody" if found.st_mode & stat.S_IWOTH else None


def own_temporary_folder() -> Path:
    """A folder of the caller's own in the temporary one, made if need be; PermissionDenied where a stranger has it."""
    folder = Path(tempfile.gettempdir()) / f"micromanip-{os.geteuid()}"
    with contextlib.suppress(FileExistsError):
        folder.mkdir(mode=0o700)
    found = folder.lstat()
    why = strangers(found) if stat.S_ISDIR(found.st_mode) else "is no folder"
    if why is not None:
        raise PermissionDenied(f"{folder} {why}: nothing in it can be believed; remove it, or set XDG_STATE_HOME")
    return folder


def marked_encoding(content: bytes) -> str | None:
    """utf-8-sig or utf-16, which decode without the mark, or None where `content` begins with no byte-order mark."""
    return next((encoding for mark, encoding in _MARKS.items() if content.startswith(mark)), None)


class HeldFolder:
    """A folder that stays the same one while it is held, whatever becomes of its name."""

    def __init__(self, path: Path, *, make: bool = False, below: Path | None = None) -> None:
        """Walk to `path`, with `make` making what is missing (0755).

        `below` is for what root writes: no link is followed from there on, and each folder must belong to root or to
        the caller; only the last may be open to others. Raises OSError.
        """
        path = path.absolute()
        self._strict = below is not None
        self._links = _MOST_LINKS
        start = below or Path("/")
        self._descriptor = os.open(start, os.O_PATH | os.O_DIRECTORY | os.O_CLOEXEC)
        try:
            self._walk(list(path.relative_to(start).parts), make)
        except BaseException:
            os.close(self._descriptor)
            raise

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None
    ) -> None:
        os.close(self._descriptor)

    def status(self) -> os.stat_result:
        """Whose it is, and who may write in it."""
        return os.fstat(self._descriptor)

    def read(self, name: str) -> bytes | None:
        """Contents of the file; None where there is none, or something that is not a file: a link, a FIFO."""
        try:
            descriptor = os.open(
                name, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC, dir_fd=self._descriptor
            )
        except OSError as problem:
            if problem.errno in (errno.ENOENT, errno.ELOOP, errno.ENXIO):
                return None
            raise
        with open(descriptor, "rb") as stream:  # noqa: PTH123 (of a descriptor)
            return stream.read() if stat.S_ISREG(os.fstat(descriptor).st_mode) else None

    def write(self, name: str, content: bytes, mode: int | None = None) -> None:
        """Replace the file, and a link itself; once it has its name it is on the disk.

        Without `mode` it keeps mode and, if that can be, owner of the one before.
        """
        part = f".{name}.{secrets.token_hex(8)}.part"
        descriptor = os.open(part, _NEW, 0o666, dir_fd=self._descriptor)
        try:
            with open(descriptor, "wb") as stream:  # noqa: PTH123 (of a descriptor)
                stream.write(content)
                stream.flush()
                self._dress(descriptor, name, mode)
                os.fsync(descriptor)
            os.rename(part, name, src_dir_fd=self._descriptor, dst_dir_fd=self._descriptor)
        except BaseException:
            with contextlib.suppress(FileNotFoundError):
                os.unlink(part, dir_fd=self._descriptor)
            raise
        self._synchronise()

    def remove(self, name: str) -> None:
        """Remove a file, a link, or a folder with all that is in it; what is not there is good."""
        with contextlib.suppress(FileNotFoundError):
            if stat.S_ISDIR(os.stat(name, dir_fd=self._descriptor, follow_symlinks=False).st_mode):
                shutil.rmtree(name, dir_fd=self._descriptor)
            else:
                os.unlink(name, dir_fd=self._descriptor)
            self._synchronise()

    def _dress(self, descriptor: int, name: str, mode: int | None) -> None:
        if mode is not None:
            os.fchmod(descriptor, mode)
            return
        with contextlib.suppress(FileNotFoundError):
            before = os.stat(name, dir_fd=self._descriptor, follow_symlinks=False)
            if stat.S_ISREG(before.st_mode):
                with contextlib.suppress(PermissionError):
                    os.fchown(descriptor, before.st_uid, before.st_gid)
                os.fchmod(descriptor, stat.S_IMODE(before.st_mode))

    def _synchronise(self) -> None:
        with contextlib.suppress(PermissionError):  # a folder that may be written, but not read
            readable = os.open(".", os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC, dir_fd=self._descriptor)
            try:
                os.fsync(readable)
            finally:
                os.close(readable)

    def _walk(self, parts: list[str], make: bool) -> None:
        while parts:
            part = parts.pop(0)
            self._judge(part)
            try:
                following = os.open(part, _FOLDER, dir_fd=self._descriptor)
            except FileNotFoundError:
                if not make:
                    raise
                with contextlib.suppress(FileExistsError):
                    os.mkdir(part, 0o755, dir_fd=self._descriptor)
                self._synchronise()
                following = os.open(part, _FOLDER, dir_fd=self._descriptor)
            except NotADirectoryError:
                parts = [*self._target(part), *parts]
                continue
            self._enter(following)
        if self._strict and os.fstat(self._descriptor).st_uid not in (0, os.geteuid()):
            raise PermissionError(errno.EPERM, f"not written, the folder is not safe: {_STICKY_OR_CLOSED}")

    def _enter(self, descriptor: int) -> None:
        os.close(self._descriptor)
        self._descriptor = descriptor

    def _judge(self, part: str) -> None:
        """Raise PermissionError where somebody else could put another folder in the place of `part`."""
        if not self._strict:
            return
        here = os.fstat(self._descriptor)
        is_closed = not here.st_mode & 0o022 or here.st_mode & stat.S_ISVTX
        if here.st_uid not in (0, os.geteuid()) or not is_closed:
            raise PermissionError(
                errno.EPERM, f"not written, the folder that {part} is in is not safe: {_STICKY_OR_CLOSED}"
            )

    def _target(self, part: str) -> list[str]:
        """Parts of the link `part`; what begins at / begins there. OSError where it is not to be followed."""
        found = os.stat(part, dir_fd=self._descriptor, follow_symlinks=False)
        if not stat.S_ISLNK(found.st_mode):
            raise NotADirectoryError(errno.ENOTDIR, os.strerror(errno.ENOTDIR))
        self._links -= 1
        if self._strict or self._links < 0 or (os.geteuid() == 0 and found.st_uid != 0):  # root follows only its own
            raise PermissionError(errno.EPERM, f"not written, {part} is a link that may lead anywhere")
        target = Path(os.readlink(part, dir_fd=self._descriptor))
        if target.is_absolute():
            self._enter(os.open("/", os.O_PATH | os.O_DIRECTORY | os.O_CLOEXEC))
        return list(target.parts[1:] if target.is_absolute() else target.parts)


def linked_file(file: Path) -> Path:
    """Where a file is that is named by a link of root's or the caller's own; anybody else's link is its own place."""
    for _ in range(_MOST_LINKS):
        with contextlib.suppress(FileNotFoundError):
            found = file.lstat()
            if stat.S_ISLNK(found.st_mode) and found.st_uid in (0, os.geteuid()):
                file = file.parent / file.readlink()
                continue
        break
    return file


@contextlib.contextmanager
def held(file: Path, *, make: bool = False, below: Path | None = None) -> Iterator[tuple[HeldFolder, str]]:
    """The folder of `file`, and its name there."""
    with HeldFolder(file.parent, make=make, below=below) as folder:
        yield folder, file.name
