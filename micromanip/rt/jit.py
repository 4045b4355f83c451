"""The one compile decorator of everything that runs at 10 kHz, and where its machine code is kept.

Rules it fixes for the whole hot path: no GIL, C division semantics (no exceptions), no
fast-math (which would make ``isfinite(nan)`` true), and a cache on disk.

Nothing is compiled, and numba is not even imported, before an entry point is called or prepared: the host and the
commands read records and call single laws as plain Python, and need no compiler for that.

The cache folder is keyed by a hash of *all* sources of the package, numba's version and the
bounds-check flag: numba's own cache looks at the file of one function only, so that a change in
a callee of another file would go unnoticed, and it ignores the flag.

If the disk takes no machine code, each process compiles its own: the start takes longer, but succeeds.
"""

from __future__ import annotations

import contextlib
import errno
import functools
import hashlib
import inspect
import os
import shutil
import sys
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from types import FunctionType
from typing import Any, ClassVar, TypeVar

from micromanip.files import strangers

Function = TypeVar("Function", bound=Callable[..., Any])

_KEPT_CACHES = 24
PLAIN = os.environ.get("NUMBA_DISABLE_JIT", "0") not in ("", "0")
"""Everything runs as plain Python: the decorators leave functions as they are."""


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
        if why := strangers(folder.parent.stat()) or strangers(folder.stat()):
            return PermissionError(errno.EPERM, f"it {why}")
        with tempfile.TemporaryFile(dir=folder) as probe:
            probe.write(b"\0")
    except OSError as problem:
        return problem
    return None


@contextlib.contextmanager
def _in_spite_of_the_disk(_cache: Any) -> Iterator[None]:
    """Compile what can't be loaded; what can't be saved is compiled again the next time."""
    with contextlib.suppress(OSError):
        yield


def _loaded(cache: Any, signature: Any, target: Any) -> Any:
    """Machine code from the disk, None where there is none.

    Numba's own method first gathers all that it could compile: a seventh of a controller's start, for nothing. Where it
    does compile it gathers that anyway.
    """
    from numba.core.runtime import rtsys

    rtsys.initialize(target)  # of all that, what machine code may call
    with cache._guard_against_spurious_io_errors():
        return cache._load_overload(signature, target)


def _places(caching: Any, config: Any) -> list[Any]:
    """Where numba looks for machine code: numba's own ways, and before these ours, by the module's name.

    Numba's own way in a given folder is by place and time of the source. Our folder is keyed by all sources already:
    whatever is installed of these very sources, wherever and whenever, shares it.
    """

    class ByModule(caching.UserProvidedCacheLocator):  # type: ignore[misc]
        def __init__(self, function: Any, file: str) -> None:
            super().__init__(function, file)
            self._cache_path = str(Path(config.CACHE_DIR, function.__module__))

        def get_source_stamp(self) -> str:
            return ""

    return [ByModule, *caching.CacheImpl._locator_classes]


@functools.cache
def _numba() -> Any:
    """numba, set to tolerate disk errors, to write less, and to load only what is needed."""
    import numba
    from numba.core import caching

    caching.CacheImpl._locator_classes = _places(caching, numba.config)
    # numba's own place for this, which it fills on Windows only; elsewhere a disk that fills would end the program
    caching.Cache._guard_against_spurious_io_errors = _in_spite_of_the_disk  # type: ignore[assignment,method-assign]
    caching.Cache.load_overload = _loaded  # type: ignore[method-assign]
    # before each of its passes numba writes out the types of all arguments: ours are records of hundreds of fields
    numba.types.Record.__repr__ = functools.cache(numba.types.Record.__repr__)  # type: ignore[method-assign]
    return numba


def _digest(folders: tuple[Path, ...]) -> str:
    from importlib.metadata import version  # takes a while, and the host never asks

    checks = os.environ.get("NUMBA_BOUNDSCHECK")
    hashed = hashlib.sha256(f"{version('numba')} {checks}".encode())
    for folder in folders:
        for source in sorted(folder.rglob("*.py")):
            hashed.update(source.read_bytes())
    return hashed.hexdigest()[:16]


def _prune(root: Path) -> None:
    """Drop the oldest caches, so that an often updated installation does not fill the disk."""
    caches = sorted((entry for entry in root.glob("*-*") if entry.is_dir()), key=lambda e: e.stat().st_mtime)
    for old in caches[:-_KEPT_CACHES]:
        shutil.rmtree(old, ignore_errors=True)


class _Made:
    """Made on first use, under numba's lock: a thread that compiles holds this lock, and needs other values meanwhile.

    A ``functools.cached_property`` of Python 3.11 has one lock for all instances, within which a thread would wait for
    another that compiles, and that one for this lock.
    """

    def __init__(self, make: Callable[[Any], Any]) -> None:
        self._make = make

    def __set_name__(self, owner: type, name: str) -> None:
        self._name = name

    def __get__(self, instance: Any, owner: type | None = None) -> Any:
        with _numba().core.compiler_lock.global_compiler_lock:
            if self._name not in vars(instance):
                vars(instance)[self._name] = self._make(instance)
            return vars(instance)[self._name]


class Compiled:
    """A function of the hot path, compiled when it is needed.

    Compiled code that calls it has it built in. Python that calls it runs an entry point's machine code, and a law as
    plain Python: a single call is not worth a compiler. `laws_compiled` makes Python's calls of laws compiled, too.
    """

    laws_compiled: ClassVar[bool] = False

    def __init__(self, function: Any, compiler: Compiler, signature: Any, *, built_in: bool = True) -> None:
        """`signature` (None for a law) makes it an entry point; `built_in`: at every call, however often it is."""
        functools.update_wrapper(self, function)
        self.py_func, self._compiler, self._signature, self._built_in = function, compiler, signature, built_in

    def __call__(self, *arguments: Any, **named: Any) -> Any:
        if self._signature is None and not self._compiler.allocates and not self.laws_compiled:
            return self.py_func(*arguments, **named)
        return self.dispatcher(*arguments, **named)

    def __reduce__(self) -> str:
        return str(self.py_func.__qualname__)

    def __getattr__(self, name: str) -> Any:
        if name.startswith("_"):
            raise AttributeError(name)
        return getattr(self.dispatcher, name)

    @_Made
    def dispatcher(self) -> Any:
        """Numba's function for calls from Python; that of an entry point is compiled, or loaded from the cache."""
        return self._compiler.build(self.py_func, self._signature)

    @_Made
    def _inner(self) -> Any:
        """Numba's function for calls from compiled code, without what Python's calls need."""
        if self._signature is not None:
            return self.dispatcher
        from .built_in import PartCompiler  # imports numba

        options = {"no_cpython_wrapper": True, "no_cfunc_wrapper": True, "forceinline": self._built_in}
        return _numba().njit(pipeline_class=PartCompiler, **self._compiler.options, **options)(self.py_func)

    @property
    def _numba_type_(self) -> Any:
        """What numba asks of a global in a function that it compiles."""
        from .built_in import BuiltIn  # imports numba

        return BuiltIn(self._inner)


class CFunction:
    """A C function that is compiled, or loaded from the cache, when its address is asked for."""

    def __init__(self, function: Any, compiler: Compiler, signature: Any) -> None:
        self.py_func, self._compiler, self._signature = function, compiler, signature

    @_Made
    def _compiled(self) -> Any:
        return self._compiler.build_c(self.py_func, self._signature)

    @property
    def address(self) -> int:
        """Where it is in this process."""
        return int(self._compiled.address)


class Compiler:
    """Decorates functions of one package for the hot path; the package's folder keys its cache.

    Inner functions are built into the entry point that calls them, and compiled without numba's memory
    management: a cycle that would allocate does not even compile. `allocates` lifts that for offline code.
    """

    tell: ClassVar[Callable[[str], None]] = staticmethod(lambda _: None)
    """Called with the name of each function that has to be compiled because it is not in the cache."""
    tell_left: ClassVar[Callable[[str, float], None]] = staticmethod(lambda _name, _seconds: None)
    """Called meanwhile with the seconds left."""

    def __init__(self, package_file: str, *, allocates: bool = False, also: tuple[Path, ...] = ()) -> None:
        """`also` are folders of other packages whose functions are built into this one's."""
        self._package, self._also = Path(package_file).resolve().parent, also
        self._caches: bool | None = None
        self.allocates = allocates
        self.options = {"nogil": True, "error_model": "numpy", "_nrt": allocates}

    @functools.cached_property
    def cache_dir(self) -> Path:
        """Where the machine code of these very sources is kept."""
        rt = Path(__file__).resolve().parent
        folders = (rt,) if self._package == rt else (rt, self._package)
        return cache_root() / f"{self._package.name}-{_digest((*folders, *self._also))}"

    def __call__(self, function: Function) -> Function:
        """Decorator: what compiled code calls is built into it."""
        return self._decorated(function, None)

    def called(self, function: Function) -> Function:
        """Decorator of what is long, and called from several places: it is called, not built in."""
        vars(function)["apart"] = ("noinline",)
        return self._decorated(function, None, built_in=False)

    def rare(self, function: Function) -> Function:
        """Decorator of what few cycles, or few axes, call: likewise, and the way there lies apart from other code."""
        vars(function)["apart"] = ("noinline", "cold")
        return self._decorated(function, None, built_in=False)

    def entry(self, signature: Any) -> Callable[[Function], Function]:
        """Decorator: what Python calls, with all that it calls built in; see ``prepare``."""
        return lambda function: self._decorated(function, signature)

    def _decorated(self, function: Function, signature: Any, **how: bool) -> Function:
        return function if PLAIN else Compiled(function, self, signature, **how)  # type: ignore[return-value]

    def c_function(self, signature: Any) -> Callable[[Any], CFunction]:
        """Decorator: a C function whose ``.address`` a driver hands to the loop."""
        return lambda function: CFunction(function, self, signature)

    def build(self, function: Any, signature: Any) -> Any:
        """Numba's function for calls from Python."""
        numba = _numba()
        return self._cached(
            function,
            lambda cache: numba.njit(signature, forceinline=signature is None, cache=cache, **self.options)(function),
            tell=signature is not None,
        )

    def build_c(self, function: Any, signature: Any) -> Any:
        """Numba's function for calls from C."""
        numba = _numba()
        return self._cached(
            function,
            lambda cache: numba.cfunc(signature, cache=cache, nopython=True, error_model="numpy")(function),
            tell=True,
        )

    def _cached(self, function: Any, build: Callable[[bool], Any], *, tell: bool) -> Any:
        """What `build(cache)` makes; whether there is a cache is found out once."""
        told = not self.keeps(function) and tell
        with contextlib.ExitStack() as stack:
            stack.enter_context(self._cache_folder())
            if told:
                from .built_in import Progress  # imports numba

                Compiler.tell(function.__name__)
                stack.enter_context(Progress.of(function, Compiler.tell_left))
            return build(bool(self._caches))

    def keeps(self, function: Any) -> bool:
        """Whether machine code of `function` is in the cache."""
        if self._caches is None:
            self._caches = self._open_cache()
        caching = _numba().core.caching
        with self._cache_folder():
            return self._caches and bool(caching.FunctionCache(inspect.unwrap(function))._cache_file._load_index())

    @contextlib.contextmanager
    def _cache_folder(self) -> Iterator[None]:
        config = _numba().config
        previous = config.CACHE_DIR
        config.CACHE_DIR = str(self.cache_dir)
        try:
            yield
        finally:
            config.CACHE_DIR = previous

    def _open_cache(self) -> bool:
        fresh = not os.path.lexists(self.cache_dir)
        why = _refusal(self.cache_dir)
        if why is not None:
            slow = f"compiled code can't be kept in {cache_root()}: {why.strerror}. Each start takes some 20 s longer"
            print(f"WARNING: {slow}", file=sys.stderr)  # noqa: T201
        elif fresh:
            _prune(self.cache_dir.parent)
        return why is None


compiled = Compiler(__file__)


def prepare(*functions: Any) -> None:
    """Compile entry points, or load them from the cache, so that nothing is compiled while the loop runs."""
    if not PLAIN:
        for function in functions:
            function.dispatcher  # noqa: B018  (made as it is looked at)


@functools.cache
def plain(law: Any) -> Any:
    """A law and the laws that it calls, as plain Python, for frequent calls: through `Compiled` a call costs 200 ns."""
    if not isinstance(law, Compiled):
        return law
    code, names = law.py_func.__code__, law.py_func.__globals__
    called = {name: plain(names[name]) for name in code.co_names if isinstance(names.get(name), Compiled)}
    return FunctionType(code, names | called, code.co_name)
