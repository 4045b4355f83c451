"""Mutation testing of the last gates before the outputs and of the fault manager: `make mutation`.

Each mutant is the module with one small change. It must fail the module's tests, or be listed with the reason why it
can't be told from the original. Exit code 1 where an unlisted mutant survives, or a listed one dies or is not made any
more. Plain Python (NUMBA_DISABLE_JIT), a forked process a mutant; nothing is written to the source tree. The usual
packages do not fit: mutmut leaves out decorated functions, which all of ours are; cosmic-ray changes files in place.
"""

import ast
import contextlib
import copy
import importlib
import importlib.abc
import importlib.util
import os
import signal
import sys
import tomllib
from collections.abc import Callable, Iterator
from pathlib import Path
from types import ModuleType

os.environ["NUMBA_DISABLE_JIT"] = "1"
import coverage  # noqa: F401  what all mutants' tests need is imported once, before the fork
import hypothesis.stateful
import hypothesis.strategies  # noqa: F401
import numba  # noqa: F401
import pytest

import micromanip.host.daemon
import micromanip.rt.laws.hysteresis
import micromanip.rt.swap  # noqa: F401

ROOT = Path(__file__).resolve().parent.parent
EQUIVALENT = ROOT / "tests" / "rt" / "equivalent_mutants.toml"
# module: its tests, and among them what looks at the source instead of the behaviour
TARGETS: dict[str, tuple[str, str | None]] = {
    "micromanip.rt.laws.limiter": ("tests/rt/test_limiter.py", "test_every_branch_is_taken"),
    "micromanip.rt.faults": ("tests/rt/test_faults.py", "test_every_branch_is_taken"),
    "micromanip.bus.safe_state": ("tests/bus/test_safe_state.py", None),
    "micromanip.host.safe.outputs": ("tests/host/test_safe_outputs.py", None),
    "micromanip.host.safe.bus_rest": ("tests/host/test_bus_rest.py", None),
}
TIMEOUT_S = 120

COMPARISONS = (ast.Lt, ast.LtE, ast.Gt, ast.GtE, ast.Eq, ast.NotEq)
ARITHMETIC = {ast.Add: ast.Sub, ast.Sub: ast.Add, ast.Mult: ast.Div, ast.Div: ast.Mult, ast.Mod: ast.Mult}


def constant(value: object) -> ast.expr:
    """A literal."""
    return ast.Constant(value=value)


def altered(node: ast.Compare | ast.BinOp | ast.BoolOp) -> Iterator[ast.expr]:
    """The same operands under other operators."""
    if isinstance(node, ast.Compare):
        for operator in COMPARISONS:
            if not isinstance(node.ops[0], operator):
                yield ast.Compare(node.left, [operator(), *node.ops[1:]], node.comparators)
    elif isinstance(node, ast.BinOp):
        if type(node.op) in ARITHMETIC:
            yield ast.BinOp(node.left, ARITHMETIC[type(node.op)](), node.right)
        yield node.left
        yield node.right
    else:
        yield ast.BoolOp(ast.Or() if isinstance(node.op, ast.And) else ast.And(), node.values)
        yield from node.values


def replacements(node: ast.AST, names: list[str], keys: list[str]) -> Iterator[ast.AST]:
    """What may stand instead of one node of a function; `names` are its variables, `keys` its records' fields."""
    if isinstance(node, ast.Compare | ast.BinOp | ast.BoolOp):
        yield from altered(node)
    elif isinstance(node, ast.Constant) and isinstance(node.value, bool):
        yield constant(not node.value)
    elif isinstance(node, ast.Constant) and isinstance(node.value, int | float):
        yield from (constant(node.value + 1), constant(-node.value if node.value else -1))
    elif isinstance(node, ast.Constant) and node.value in keys:
        yield from (constant(key) for key in keys if key != node.value)
    elif isinstance(node, ast.Name) and isinstance(node.ctx, ast.Load) and node.id in names:
        yield from (ast.Name(name, ast.Load()) for name in names if name != node.id)
    elif isinstance(node, ast.UnaryOp):
        yield node.operand
    elif isinstance(node, ast.IfExp):
        yield from (node.body, node.orelse, ast.IfExp(node.test, node.orelse, node.body))
    elif isinstance(node, ast.If | ast.While):
        for always in (True, False) if isinstance(node, ast.If) else (False,):
            yield type(node)(constant(always), node.body, node.orelse)
    elif isinstance(node, ast.Return) and node.value is not None:
        yield from (ast.Return(constant(0.0)), ast.Return(ast.UnaryOp(ast.USub(), node.value)))
    elif isinstance(node, ast.Assign | ast.AugAssign):
        yield ast.Pass()
    elif isinstance(node, ast.Call) and len(node.args) > 1:
        yield ast.Call(node.func, [*node.args[1::-1], *node.args[2:]], node.keywords)


def places(function: ast.FunctionDef) -> list[tuple[ast.AST, str, int | None]]:
    """Every node of the body but the docstring, as its parent, field and index."""
    found: list[tuple[ast.AST, str, int | None]] = []

    def walk(parent: ast.AST) -> None:
        for field, value in ast.iter_fields(parent):
            if field in ("annotation", "returns"):
                continue
            for i, child in enumerate(value) if isinstance(value, list) else [(None, value)]:
                if isinstance(child, ast.AST):
                    found.append((parent, field, i))
                    walk(child)

    body = ast.Module(function.body[1:] if ast.get_docstring(function) else function.body, [])
    walk(body)
    return found


def mutants(tree: ast.Module) -> Iterator[tuple[str, ast.Module]]:
    """(what was changed, the changed module); names are unique and do not depend on line numbers."""
    seen: dict[str, int] = {}
    for original, module_with in functions(tree):
        used = [node for node in ast.walk(original) if isinstance(node, ast.Name)]
        loaded = {node.slice.value for node in ast.walk(original) if isinstance(node, ast.Subscript)
                  and isinstance(node.slice, ast.Constant) and isinstance(node.slice.value, str)}  # fmt: skip
        indexed = {node.value.id for node in ast.walk(original) if isinstance(node, ast.Subscript)
                   and isinstance(node.value, ast.Name)}  # fmt: skip
        variables = {argument.arg for argument in original.args.args if argument.arg != "self"}
        variables |= {node.id for node in used if isinstance(node.ctx, ast.Store)}
        names = sorted(variables - indexed)
        for number in range(len(places(original))):
            spare = copy.deepcopy(original)
            parent, field, i = places(spare)[number]
            node = getattr(parent, field) if i is None else getattr(parent, field)[i]
            for new in replacements(node, names, sorted(loaded)):
                changed = copy.deepcopy(original)
                parent, field, i = places(changed)[number]
                if i is None:
                    setattr(parent, field, new)
                else:
                    getattr(parent, field)[i] = new
                    if isinstance(parent, ast.Module):  # a statement of the function's own body
                        changed.body[i + bool(ast.get_docstring(changed))] = new  # type: ignore[call-overload]
                name = _name(original, changed)
                seen[name] = seen.get(name, 0) + 1
                if seen[name] == 1:
                    yield name, ast.fix_missing_locations(module_with(changed))


def functions(tree: ast.Module) -> Iterator[tuple[ast.FunctionDef, Callable[[ast.FunctionDef], ast.Module]]]:
    """Every function and method, and what makes the module with another one in its place."""
    for k, entry in enumerate(tree.body):
        if isinstance(entry, ast.FunctionDef):
            yield entry, lambda new, k=k: replaced(tree, k, new)
        elif isinstance(entry, ast.ClassDef):
            for i, method in enumerate(entry.body):
                if isinstance(method, ast.FunctionDef):
                    yield method, lambda new, k=k, i=i: replaced(tree, k, replaced(tree.body[k], i, new))


def replaced(parent: ast.Module | ast.ClassDef, k: int, new: ast.stmt) -> ast.Module | ast.ClassDef:
    """The same with `new` in place of the statement number `k`."""
    other = copy.copy(parent)
    other.body = [*parent.body[:k], new, *parent.body[k + 1 :]]
    return other


def _name(original: ast.FunctionDef, changed: ast.FunctionDef) -> str:
    """The line that changed: before -> after."""
    before, after = ast.unparse(original).splitlines(), ast.unparse(changed).splitlines()
    k = next(k for k, (old, new) in enumerate(zip(before, after, strict=False)) if old != new)
    earlier = before[:k].count(before[k])
    return f"{original.name}: {before[k].strip()} -> {after[k].strip()}" + (f" ({earlier + 1})" if earlier else "")


class Substitute(importlib.abc.MetaPathFinder, importlib.abc.Loader):
    """Imports the mutant instead of the module."""

    def __init__(self, name: str, tree: ast.Module, file: str) -> None:
        self.name, self.tree, self.file = name, tree, file

    def find_spec(self, name, path=None, target=None):
        """Only the one module."""
        return importlib.util.spec_from_loader(name, self, origin=self.file) if name == self.name else None

    def exec_module(self, module: ModuleType) -> None:
        """The mutant's code."""
        module.__file__ = self.file
        exec(compile(self.tree, self.file, "exec"), module.__dict__)


def start(module: str, tree: ast.Module, file: str) -> int:
    """Run the module's tests on `tree` in a process of its own; its id."""
    tests, but = TARGETS[module]
    child = os.fork()
    if child:
        return child
    code = 70
    with contextlib.suppress(Exception):
        null = os.open(os.devnull, os.O_WRONLY)
        os.dup2(null, 1)
        os.dup2(null, 2)
        signal.alarm(TIMEOUT_S)
        sys.meta_path.insert(0, Substitute(module, tree, file))
        # the tests, without the folder that they would look into; a failure is all that is wanted to know
        code = pytest.main(
            [
                "-x",
                "-q",
                "--tb=no",
                "-p",
                "no:xdist",
                "-p",
                "no:rerunfailures",  # a mutant's failure is no accident
                "-o",
                "markers=flaky: as of rerunfailures\nxdist_group: as of xdist",
                "-W",
                "ignore::pytest.PytestAssertRewriteWarning",
                str(ROOT / tests),
                *([f"--deselect={tests}::{but}"] if but else []),
            ]
        )
    os._exit(int(code))


def survivors(module: str, cases: list[tuple[str, ast.Module]], file: str) -> list[str]:
    """Names of the mutants whose tests all passed."""
    alive, running = [], {}
    for name, tree in [*cases, (None, None)]:
        while len(running) >= (os.cpu_count() or 1) or (name is None and running):
            child, status = os.wait()
            finished = running.pop(child)
            code = os.waitstatus_to_exitcode(status)
            if code == 0:
                alive.append(finished)
            elif code not in (1, -signal.SIGALRM, -signal.SIGSEGV):
                sys.exit(f"{finished}: the tests could not be run (exit code {code})")
            print("." if code else "S", end="", file=sys.stderr, flush=True)
        if name is not None:
            running[start(module, tree, file)] = name
    print(file=sys.stderr)
    return alive


def main() -> int:
    """0 where exactly the listed mutants survive."""
    os.chdir(ROOT)
    reasons = {
        (entry["module"], entry["mutant"]): entry["reason"]
        for entry in tomllib.loads(EQUIVALENT.read_text())["equivalent"]
    }
    wrong = 0
    for module in sys.argv[1:] or TARGETS:
        file = str(ROOT / (module.replace(".", "/") + ".py"))
        tree = ast.parse(Path(file).read_text())
        if survivors(module, [("the module as it is", tree)], file) != ["the module as it is"]:
            sys.exit(f"{module}: its tests fail without any mutation")
        cases = list(mutants(tree))
        alive = survivors(module, cases, file)
        listed = {mutant for known, mutant in reasons if known == module}
        gone = listed - {name for name, _ in cases}
        for text, names in (
            ("survives, and is not listed as equivalent", set(alive) - listed),
            ("is listed as equivalent, but dies", listed - set(alive) - gone),
            ("is listed as equivalent, but is not among the mutants", gone),
        ):
            for name in sorted(names):
                wrong += 1
                print(f"{module}: {text}: {name}")
        print(
            f"{module}: {len(cases)} mutants, {len(cases) - len(alive)} killed, {len(set(alive) & listed)} equivalent"
        )
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
