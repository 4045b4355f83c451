"""The one compile decorator of everything that runs at 10 kHz, and where its machine code is kept.

Rules it fixes for the whole hot path: no GIL, C division semantics (no exceptions), no
fast-math (which would make ``isfinite(nan)`` true), and a cache on disk.

The cache folder is keyed by a hash of *all* sources of the package, numba's version and the
bounds-check flag: numba's own cache looks at the file of one function only, so that a change in
a callee of another file would go unnoticed, and it ignores the flag.

A disk that takes no machine code costs time, never the start: it is then kept in a temporary folder, for this process
and its children, or not at all.
"""

from __future__ import annotations

import atexit
import contextlib
import hashlib
import os
import shutil
import sys
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, TypeVar

import numba
from numba.core import caching

Function = TypeVar("Function", bound=Callable[..., Any])

_KEPT_CACHES = 24


def cache_root() -> Path:
    """Folder of all compiled code: ``$XDG_CACHE_HOME/micromanip`` or ``~/.cache/micromanip``."""
    base = os.environ.get("XDG_CACHE_HOME")
    try:
        return (Path(base) if base else Path.home() / ".cache") / "micromanip"
    except RuntimeError:  # a user without a home: a place where nothing can be made
        return Path(os.devnull) / "micromanip"


def _refusal(folder: Path) -> OSError | None:
    """Why `folder`, made if need be, takes no files; None where it does."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder) as probe:
            probe.write(b"\0")
    except OSError as problem:
        return problem
    return None


def _move_to_a_refuge(why: OSError) -> Path | None:
    """Another root of all caches of this process and its children, removed with it; None where there is no room."""
    print(  # noqa: T201
        f"WARNING: compiled code can't be kept in {cache_root()}: {why.strerror}. Each start takes a minute longer",
        file=sys.stderr,
    )
    try:
        refuge = Path(tempfile.mkdtemp(prefix="micromanip-cache-"))
    except OSError:
        return None
    with contextlib.suppress(OSError, shutil.Error):  # what is there may be read at least
        shutil.copytree(cache_root(), refuge / "micromanip")
    os.environ["XDG_CACHE_HOME"] = str(refuge)
    atexit.register(_leave, refuge, os.getpid())
    return refuge / "micromanip"


def _leave(refuge: Path, owner: int) -> None:
    if os.getpid() == owner:
        shutil.rmtree(refuge, ignore_errors=True)


@contextlib.contextmanager
def _in_spite_of_the_disk(_cache: caching.Cache) -> Iterator[None]:
    """What can't be loaded is compiled, what can't be saved is compiled again the next time."""
    with contextlib.suppress(OSError):
        yield


# numba's own place for this, which it fills on Windows only; elsewhere a disk that fills would end the program
caching.Cache._guard_against_spurious_io_errors = _in_spite_of_the_disk  # type: ignore[assignment,method-assign]


def _digest(folders: tuple[Path, ...]) -> str:
    hashed = hashlib.sha256(f"{numba.__version__} {numba.config.BOUNDSCHECK}".encode())
    for folder in folders:
        for source in sorted(folder.rglob("*.py")):
            hashed.update(source.read_bytes())
    return hashed.hexdigest()[:16]


def _prune(root: Path) -> None:
    """Drop the oldest caches, so that an often updated installation does not fill the disk."""
    caches = sorted((entry for entry in root.glob("*-*") if entry.is_dir()), key=lambda e: e.stat().st_mtime)
    for old in caches[:-_KEPT_CACHES]:
        shutil.rmtree(old, ignore_errors=True)


class Compiler:
    """Decorates functions of one package for the hot path; the package's folder keys its cache.

    Inner functions are inlined into the entry point that calls them, and compiled without numba's memory
    management: a cycle that would allocate does not even compile. `allocates` lifts that for offline code.
    """

    def __init__(self, package_file: str, *, allocates: bool = False) -> None:
        own = Path(package_file).resolve().parent
        rt = Path(__file__).resolve().parent
        self.cache_dir = cache_root() / f"{own.name}-{_digest((rt, own) if own != rt else (rt,))}"
        self._caches: bool | None = None
        self._options = {"nogil": True, "error_model": "numpy", "_nrt": allocates}

    def __call__(self, function: Function) -> Function:
        """Decorator: compiled when first called; what an entry point calls is built into the entry point."""
        compiled_function: Function = self._compile(function, None)
        return compiled_function

    def entry(self, signature: Any) -> Callable[[Function], Function]:
        """Decorator: compiled, or loaded from the cache, at once, so that nothing is compiled while the loop runs."""
        return lambda function: self._compile(function, signature)

    def _compile(self, function: Any, signature: Any) -> Any:
        inlined = signature is None
        return self._cached(
            lambda cache: numba.njit(signature, forceinline=inlined, cache=cache, **self._options)(function)
        )

    def c_function(self, signature: Any) -> Callable[[Any], Any]:
        """Decorator: compiles to a C function whose ``.address`` a driver hands to the loop."""
        return lambda function: self._cached(
            lambda cache: numba.cfunc(signature, cache=cache, nopython=True, error_model="numpy")(function)
        )

    def _cached(self, build: Callable[[bool], Any]) -> Any:
        """What `build(cache)` makes; whether there is a cache is found out once."""
        if self._caches is None:
            self._caches = self._open_cache()
        previous = numba.config.CACHE_DIR
        numba.config.CACHE_DIR = str(self.cache_dir)
        try:
            return build(self._caches)
        finally:
            numba.config.CACHE_DIR = previous

    def _open_cache(self) -> bool:
        fresh = not os.path.lexists(self.cache_dir)
        why = _refusal(self.cache_dir)
        if why is not None:
            root = _move_to_a_refuge(why)
            if root is None:
                return False
            self.cache_dir = root / self.cache_dir.name
            return _refusal(self.cache_dir) is None
        if fresh:
            _prune(self.cache_dir.parent)
        return True


compiled = Compiler(__file__)
