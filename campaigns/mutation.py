"""Mutation testing of the last gates before the outputs and of the fault manager.

Each mutant is the module with one small change of one function. It must fail the module's tests, or be listed with the
reason why it can't be told from the original. Wrong is an unlisted mutant that survives, and a listed one that dies or
is not made any more. The laws are plain Python (NUMBA_DISABLE_JIT). The tests are collected once; a mutant is a forked
process that puts the changed code into the function and runs them until one fails, those first that have killed most.
Nothing is written to the source tree. The usual packages do not fit: mutmut leaves out decorated functions, which all
of ours are; cosmic-ray changes files in place.
"""

import ast
import contextlib
import copy
import importlib
import inspect
import os
import re
import resource
import signal
import sys
import tomllib
from collections.abc import Iterator
from types import CodeType, FunctionType

os.environ["NUMBA_DISABLE_JIT"] = "1"
import pytest
from _pytest.runner import runtestprotocol

from .report import ROOT, Asked, Report

EQUIVALENT = ROOT / "tests" / "rt" / "equivalent_mutants.toml"
_OF_GATES = "tests/bus/test_safe_state.py tests/bus/test_after_silence.py"
TARGETS = {
    "micromanip.rt.laws.saturation": "tests/rt/test_limiter.py",
    "micromanip.rt.faults": "tests/rt/test_faults.py",
    "micromanip.rt.io.gate": _OF_GATES,
    "micromanip.bus.safe_state": f"{_OF_GATES} tests/host/test_bus_rest.py",
    "micromanip.bus.beginning": "tests/bus/test_after_silence.py",
    "micromanip.host.safe.outputs": "tests/host/test_safe_outputs.py",
    "micromanip.host.safe.bus_rest": "tests/host/test_bus_rest.py",
}
"""Tests of each module."""
TIMES, AT_LEAST_S, WAIT_S = 10, 3, 120
"""A mutant that takes so many times the processor time of the original, or waits for so long, comes to no end."""

COMPARISONS = (ast.Lt, ast.LtE, ast.Gt, ast.GtE, ast.Eq, ast.NotEq)
ARITHMETIC = {ast.Add: ast.Sub, ast.Sub: ast.Add, ast.Mult: ast.Div, ast.Div: ast.Mult, ast.Mod: ast.Mult}


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
        yield ast.Constant(not node.value)
    elif isinstance(node, ast.Constant) and isinstance(node.value, int | float):
        yield from (ast.Constant(node.value + 1), ast.Constant(-node.value if node.value else -1))
    elif isinstance(node, ast.Constant) and node.value in keys:
        yield from (ast.Constant(key) for key in keys if key != node.value)
    elif isinstance(node, ast.Name) and isinstance(node.ctx, ast.Load) and node.id in names:
        yield from (ast.Name(name, ast.Load()) for name in names if name != node.id)
    elif isinstance(node, ast.UnaryOp):
        yield node.operand
    elif isinstance(node, ast.IfExp):
        yield from (node.body, node.orelse, ast.IfExp(node.test, node.orelse, node.body))
    elif isinstance(node, ast.If | ast.While):
        for always in (True, False) if isinstance(node, ast.If) else (False,):
            yield type(node)(ast.Constant(always), node.body, node.orelse)
    elif isinstance(node, ast.Return) and node.value is not None:
        yield ast.Return(ast.Constant(0.0))
        is_true_or_false = isinstance(node.value, ast.Compare | ast.BoolOp) or called(node.value) in ("all", "any")
        if not (is_true_or_false or (isinstance(node.value, ast.Constant) and isinstance(node.value.value, bool))):
            yield ast.Return(ast.UnaryOp(ast.USub(), node.value))  # of a truth value it is the same one
    elif isinstance(node, ast.Assign | ast.AugAssign):
        yield ast.Pass()
    elif isinstance(node, ast.Call) and len(node.args) > 1 and called(node) not in ("min", "max"):
        yield ast.Call(node.func, [*node.args[1::-1], *node.args[2:]], node.keywords)


def called(node: ast.expr) -> str | None:
    """Name of the function that is called."""
    return node.func.id if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) else None


def within(parent: ast.AST) -> Iterator[tuple[ast.AST, ast.AST]]:
    """Every node below `parent` but type hints and the docstring of a function, each behind its own parent."""
    for field, value in ast.iter_fields(parent):
        for child in value if isinstance(value, list) else [value]:
            if isinstance(child, ast.AST) and field not in ("annotation", "returns"):
                yield parent, child
                yield from within(child)


def mutants(tree: ast.Module) -> Iterator[tuple[str, ast.FunctionDef, ast.FunctionDef]]:
    """(what was changed, a function or method, what it becomes); names are unique, without line numbers."""
    seen = set()
    holders = [tree, *(entry for entry in tree.body if isinstance(entry, ast.ClassDef))]
    for function in (entry for holder in holders for entry in holder.body if isinstance(entry, ast.FunctionDef)):
        nodes = [*ast.walk(function)]
        loaded = {node.slice.value for node in nodes if isinstance(node, ast.Subscript)
                  and isinstance(node.slice, ast.Constant) and isinstance(node.slice.value, str)}  # fmt: skip
        indexed = {node.value.id for node in nodes if isinstance(node, ast.Subscript)
                   and isinstance(node.value, ast.Name)}  # fmt: skip
        variables = {argument.arg for argument in function.args.args if argument.arg != "self"}
        variables |= {node.id for node in nodes if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store)}
        body = ast.Module(function.body[1:] if ast.get_docstring(function) else function.body, [])
        for parent, node in within(body):
            for new in replacements(node, sorted(variables - indexed), sorted(loaded)):
                if isinstance(parent, ast.Subscript) and ast.unparse(new) == "-1":
                    continue  # a record's numbers are arrays of one
                changed = copy.deepcopy(function, {id(node): new})  # with `new` for a copy of the node
                name = _name(function, changed)
                if name not in seen:
                    seen.add(name)
                    yield name, function, changed


def _name(original: ast.FunctionDef, changed: ast.FunctionDef) -> str:
    """The line that changed: before -> after."""
    before, after = ast.unparse(original).splitlines(), ast.unparse(changed).splitlines()
    k = next(k for k, (old, new) in enumerate(zip(before, after, strict=False)) if old != new)
    earlier = before[:k].count(before[k])
    return f"{original.name}: {before[k].strip()} -> {after[k].strip()}" + (f" ({earlier + 1})" if earlier else "")


class Mutants:
    """A pytest plugin: runs the collected tests once a mutant, instead of once."""

    def __init__(self, module: str) -> None:
        self._module = importlib.import_module(module)
        self._tree = ast.parse(inspect.getsource(self._module))
        self.cases = list(mutants(self._tree))
        self.alive: list[str] = []
        self._items: list[pytest.Item] = []
        """The one that killed last comes first."""

    @pytest.hookimpl(tryfirst=True)
    def pytest_runtestloop(self, session):
        """The module as it is must pass; then every mutant."""
        session.config._tmp_path_factory.getbasetemp()  # one for all processes
        self._items = [*session.items]
        before_s = resource.getrusage(resource.RUSAGE_CHILDREN).ru_utime
        child, answer = self._start(self._tree, WAIT_S)
        if code := self._ended(answer, os.waitpid(child, 0)[1]):
            sys.exit(f"{self._module.__name__}: its tests fail without any mutation: {self._items[0].nodeid}, {code}")
        needed_s = resource.getrusage(resource.RUSAGE_CHILDREN).ru_utime - before_s
        running: dict[int, tuple[str, int]] = {}
        for name, *change in [*self.cases, (None, None, None)]:
            while len(running) >= (os.cpu_count() or 1) or (name is None and running):
                child, status = os.wait()
                finished, answer = running.pop(child)
                code = self._ended(answer, status)
                if code == 0:
                    self.alive.append(finished)
                elif code not in (1, -signal.SIGALRM, -signal.SIGVTALRM, -signal.SIGSEGV):
                    sys.exit(f"{finished}: the tests could not be run (exit code {code})")
                print("." if code else "S", end="", file=sys.stderr, flush=True)
            if name is not None:
                function, changed = change
                tree = ast.fix_missing_locations(copy.deepcopy(self._tree, {id(function): changed}))
                child, answer = self._start(tree, max(AT_LEAST_S, round(TIMES * needed_s)))
                running[child] = (name, answer)
        print(file=sys.stderr)
        return True

    def _start(self, tree: ast.Module, most_s: int) -> tuple[int, int]:
        """Run the tests on `tree` in a process of its own; its id, and where the name of the one that fails comes."""
        answer, end = os.pipe()
        child = os.fork()
        if child:
            os.close(end)
            return child, answer
        code = 70
        with contextlib.suppress(Exception):
            null = os.open(os.devnull, os.O_WRONLY)
            os.dup2(null, 1)
            os.dup2(null, 2)
            signal.setitimer(signal.ITIMER_VIRTUAL, most_s)
            signal.alarm(WAIT_S)
            put_in_place(self._module, tree)
            code = 0
            for item, following in zip(self._items, [*self._items[1:], None], strict=True):
                if any(report.failed for report in runtestprotocol(item, nextitem=following, log=False)):
                    os.write(end, item.nodeid.encode())
                    code = 1
                    break
        os._exit(code)

    def _ended(self, answer: int, status: int) -> int:
        """Exit code of a process."""
        with os.fdopen(answer) as end:
            if killer := end.read():
                self._items.sort(key=lambda item: item.nodeid != killer)
        return os.waitstatus_to_exitcode(status)


def put_in_place(module: object, tree: ast.Module) -> None:
    """Give each function of the module the code that it has in `tree`; whoever holds it already runs that too."""

    def walk(code: CodeType, holder: object) -> None:
        for inner in code.co_consts:
            found = vars(holder).get(inner.co_name) if isinstance(inner, CodeType) else None
            if isinstance(found, type):
                walk(inner, found)
            elif found is not None:
                function = inspect.unwrap(getattr(found, "fget", None) or getattr(found, "__func__", found))
                if isinstance(function, FunctionType) and function.__code__.co_qualname == inner.co_qualname:
                    function.__code__ = inner

    walk(compile(tree, module.__file__, "exec"), module)


def tried(module: str) -> Mutants:
    """All mutants of a module, with those that have survived."""
    found = Mutants(module)
    options = ["-q", "--capture=no", "--hypothesis-profile=mutation", "-p", "no:xdist", "-m", "not live"]
    options += ["-o", "markers=xdist_group: as of xdist"]
    files = [str(ROOT / file) for file in TARGETS[module].split()]
    code = pytest.main(options + files, plugins=[found])
    if code:
        sys.exit(f"{module}: the tests could not be run (exit code {int(code)})")
    return found


def run(asked: Asked) -> Report:
    """All modules, or those whose names `only` finds."""
    os.chdir(ROOT)
    reasons = {
        (entry["module"], mutant): entry["reason"]
        for entry in tomllib.loads(EQUIVALENT.read_text())["equivalent"]
        for mutant in entry.get("mutants", [entry.get("mutant")])
    }
    report, rows = Report(), []
    for module in filter(re.compile(asked.only).search, TARGETS):
        found = tried(module)
        names, alive = {name for name, *_ in found.cases}, set(found.alive)
        listed = {mutant for known, mutant in reasons if known == module}
        for text, wrong in (
            ("survives, and is not listed as equivalent", alive - listed),
            ("is listed as equivalent, but dies", (listed & names) - alive),
            ("is listed as equivalent, but is not among the mutants", listed - names),
        ):
            report.wrong += [f"{module}: {text}: {name}" for name in sorted(wrong)]
        rows.append({"module": module, "mutants": len(found.cases), "killed": len(found.cases) - len(found.alive),
                     "equivalent": len(alive & listed)})  # fmt: skip
    report.tables["mutants"] = rows
    return report
