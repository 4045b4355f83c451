"""The one compile decorator of everything that runs at 10 kHz, and where its machine code is kept.

Rules it fixes for the whole hot path: no GIL, C division semantics (no exceptions), no
fast-math (which would make ``isfinite(nan)`` true), and a cache on disk.

The cache folder is keyed by a hash of *all* sources of the package, numba's version and the
bounds-check flag: numba's own cache looks at the file of one function only, so that a change in
a callee of another file would go unnoticed, and it ignores the flag.
"""

from __future__ import annotations

import hashlib
import os
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

import numba

Function = TypeVar("Function", bound=Callable[..., Any])

_KEPT_CACHES = 24


def cache_root() -> Path:
    """Folder of all compiled code: ``$XDG_CACHE_HOME/micromanip`` or ``~/.cache/micromanip``."""
    base = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    return Path(base) / "micromanip"


def _digest(folders: tuple[Path, ...]) -> str:
    hashed = hashlib.sha256(f"{numba.__version__} {numba.config.BOUNDSCHECK}".encode())
    for folder in folders:
        for source in sorted(folder.glob("*.py")):
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
        self._options = {"cache": True, "nogil": True, "error_model": "numpy", "_nrt": allocates}

    def __call__(self, function: Function) -> Function:
        """Decorator: compiled when first called; what an entry point calls is built into the entry point."""
        compiled_function: Function = self._compile(function, None)
        return compiled_function

    def entry(self, signature: Any) -> Callable[[Function], Function]:
        """Decorator: compiled, or loaded from the cache, at once, so that nothing is compiled while the loop runs."""
        return lambda function: self._compile(function, signature)

    def _compile(self, function: Any, signature: Any) -> Any:
        return self._cached(lambda: numba.njit(signature, forceinline=signature is None, **self._options)(function))

    def c_function(self, signature: Any) -> Callable[[Any], Any]:
        """Decorator: compiles to a C function whose ``.address`` a driver hands to the loop."""
        return lambda function: self._cached(
            lambda: numba.cfunc(signature, cache=True, nopython=True, error_model="numpy")(function)
        )

    def _cached(self, build: Callable[[], Any]) -> Any:
        fresh = not self.cache_dir.is_dir()
        self.cache_dir.mkdir(parents=True, exist_ok=True)
        if fresh:
            _prune(self.cache_dir.parent)
        previous = numba.config.CACHE_DIR
        numba.config.CACHE_DIR = str(self.cache_dir)
        try:
            return build()
        finally:
            numba.config.CACHE_DIR = previous


compiled = Compiler(__file__)
