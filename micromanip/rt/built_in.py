"""How numba compiles functions that only compiled code calls: as parts of their callers, without an entry of their own.

Numba optimises each function in full, with all that it calls, and makes machine code of it. A law is built into an
entry point through five or six others: the same code was optimised and translated as often, though only the last can
be called. A part is linked into its caller after a first cheap simplification. The optimiser of the entry point sees
the whole cycle, and sees it once.
"""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Iterator
from types import SimpleNamespace
from typing import Any, ClassVar

from numba import types
from numba.core import typed_passes, untyped_passes
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import Compiler
from numba.core.compiler_machinery import PassManager
from numba.extending import models, register_model

from . import vectors  # noqa: F401  (machine code of its own)

_PARTS_SHARE = 0.7
"""Of the time that an entry point takes; the optimiser has the rest, which can't be watched."""
_EVERY_S, _FIRST_S, _SAYS_LITTLE = 3.0, 2.0, 0.05


class BuiltIn(types.Dispatcher):
    """One specialisation for all values of an argument: numba would make one for each literal fault code."""

    def get_call_type(self, context: Any, args: Any, kws: Any) -> Any:
        """Types of result and arguments of a call."""
        plain = types.unliteral
        return super().get_call_type(
            context, tuple(map(plain, args)), {name: plain(kind) for name, kind in kws.items()}
        )


register_model(BuiltIn)(models.OpaqueModel)


class _Part(JITCodeLibrary):
    """Code that is linked into others and has no address."""

    codegen = SimpleNamespace(set_env=lambda _name, _environment: None)
    """By this numba writes to a variable of the machine code, which there is none of."""

    apart: tuple[str, ...] = ()
    """How the optimiser is told that this is called, which it would build in where one place calls it."""

    def add_ir_module(self, ir_module: Any) -> None:
        """Take over what numba made of the function."""
        for function in ir_module.functions:
            if not function.is_declaration:
                function.attributes.update(self.apart)
        super().add_ir_module(ir_module)

    def get_pointer_to_function(self, _name: str) -> int:
        """Zero, numba's word for no such code."""
        self._ensure_finalized()
        return 0

    def _optimize_final_module(self) -> None:
        passes, builder = self._codegen._module_pass_manager(loop_vectorize=False, opt=0, cost="cheap")
        passes.run(self._final_module, builder)

    def _finalize_final_module(self) -> None:
        self._finalize_dynamic_globals()
        self._verify_declare_only_symbols()
        self._finalized = True


_UNTYPED = (
    *("TranslateByteCode", "FixupArgs", "IRProcessing", "RewriteSemanticConstants", "DeadBranchPrune"),
    *("GenericRewrites", "ReconstructSSA"),
)
_TYPED = (
    *("NopythonTypeInference", "PreLowerStripPhis", "NoPythonSupportedFeatureValidation", "IRLegalization"),
    *("NativeLowering", "NoPythonBackend"),
)


class PartCompiler(Compiler):
    """Numba's compiler, but that what it compiles is a part."""

    def __init__(self, typing: Any, target: Any, library: Any, *rest: Any) -> None:
        super().__init__(typing, target, library or _Part(target.codegen(), "part"), *rest)

    def define_pipelines(self) -> list[Any]:
        """Numba's passes without those for what no law has: closures, `with`, raises, literals that are unrolled."""
        passes = PassManager("part")
        for module, names in ((untyped_passes, _UNTYPED), (typed_passes, _TYPED)):
            for name in names:
                passes.add_pass(getattr(module, name), name)
        passes.finalize()
        return [passes]

    def compile_extra(self, func: Any) -> Any:
        """Numba's result for `func`."""
        self.state.library.apart = vars(func).get("apart", ())
        made = super().compile_extra(func)
        if Progress.current is not None:
            Progress.current.compiled(func)
        return made


class Progress:
    """How far numba is with an entry point: the functions that are built into it, by the length of their code."""

    current: ClassVar[Progress | None] = None
    """Of the entry point that is compiled at present, under numba's lock."""

    def __init__(self, function: Any, tell: Callable[[str, float], None]) -> None:
        """`tell` gets the name of `function` and the seconds that are left, now and then."""
        self._name, self._tell = function.__name__, tell
        self._left = {each: len(each.__code__.co_code) for each in _built_into(function)}
        self._all = sum(self._left.values())
        self._began = time.monotonic()
        self._next_s = self._began + _FIRST_S

    @classmethod
    @contextlib.contextmanager
    def of(cls, function: Any, tell: Callable[[str, float], None]) -> Iterator[None]:
        """While `function` is compiled, within another entry point or by itself."""
        outer = cls.current
        cls.current = outer or cls(function, tell)
        try:
            yield
        finally:
            cls.current = outer

    def compiled(self, function: Any) -> None:
        """`function` is ready to be built in."""
        self._left.pop(function, None)
        now = time.monotonic()
        share = _PARTS_SHARE * (1.0 - sum(self._left.values()) / self._all)
        if now >= self._next_s and share > _SAYS_LITTLE:
            self._next_s = now + _EVERY_S
            self._tell(self._name, (now - self._began) * (1.0 - share) / share)


def _built_into(function: Any) -> set[Any]:
    """The Python functions that the compiled `function` calls, and those that these call; with itself."""
    found, ahead = set(), [function]
    while ahead:
        each = ahead.pop()
        if each not in found:
            found.add(each)
            ahead += _called(each)
    return found


def _called(function: Any) -> Iterator[Any]:
    for name in function.__code__.co_names:
        inner = getattr(function.__globals__.get(name), "py_func", None)
        if hasattr(inner, "__code__"):
            yield inner
