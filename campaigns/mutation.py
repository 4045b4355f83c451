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
import resource
import signal
import sys
import tomllib
from collections import Counter
from collections.abc import Callable, Iterator
from types import CodeType, FunctionType

os.environ["NUMBA_DISABLE_JIT"] = "1"
import pytest
from _pytest.runner import runtestprotocol

from .report import ROOT, Asked, Report

EQUIVALENT = ROOT / "tests" / "rt" / "equivalent_mutants.toml"
# module: its tests, and among them what looks at the source instead of the behaviour
TARGETS: dict[str, tuple[str, str | None]] = {
    "micromanip.rt.laws.saturation": ("tests/rt/test_limiter.py", "test_every_branch_is_taken"),
    "micromanip.rt.faults": ("tests/rt/test_faults.py", "test_every_branch_is_taken"),
    "micromanip.rt.io.gate": ("tests/bus/test_safe_state.py", None),
    "micromanip.bus.safe_state": (
        "tests/bus/test_safe_state.py tests/bus/test_after_silence.py tests/host/test_bus_rest.py",
        None,
    ),
    "micromanip.bus.beginning": ("tests/bus/test_after_silence.py", None),
    "micromanip.host.safe.outputs": ("tests/host/test_safe_outputs.py", None),
    "micromanip.host.safe.bus_rest": ("tests/host/test_bus_rest.py", None),
}
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
                if isinstance(parent, ast.Subscript) and ast.unparse(new) == "-1":
                    continue  # a record's numbers are arrays of one
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


class Mutants:
    """A pytest plugin: runs the collected tests once a mutant, instead of once."""

    def __init__(self, module: str) -> None:
        self._module = importlib.import_module(module)
        self.tree = ast.parse(inspect.getsource(self._module))
        self.cases = list(mutants(self.tree))
        self.alive: list[str] = []
        self._kills: Counter[str] = Counter()

    @pytest.hookimpl(tryfirst=True)
    def pytest_runtestloop(self, session):
        """The module as it is must pass; then every mutant."""
        session.config._tmp_path_factory.getbasetemp()  # one for all processes
        before_s = resource.getrusage(resource.RUSAGE_CHILDREN).ru_utime
        killer, status = self._end(*self._start(session.items, self.tree, WAIT_S))
        if status:
            sys.exit(f"{self._module.__name__}: its tests fail without any mutation: {killer or status}")
        needed_s = resource.getrusage(resource.RUSAGE_CHILDREN).ru_utime - before_s
        self._try_all(session.items, max(AT_LEAST_S, round(TIMES * needed_s)))
        return True

    def _try_all(self, items: list[pytest.Item], most_s: int) -> None:
        running: dict[int, tuple[str, int]] = {}
        for name, tree in [*self.cases, (None, None)]:
            while len(running) >= (os.cpu_count() or 1) or (name is None and running):
                child, status = os.wait()
                finished, answer = running.pop(child)
                killer, code = self._end(child, answer, status)
                self._kills.update([killer] if killer else [])
                if code == 0:
                    self.alive.append(finished)
                elif code not in (1, -signal.SIGALRM, -signal.SIGVTALRM, -signal.SIGSEGV):
                    sys.exit(f"{finished}: the tests could not be run (exit code {code})")
                print("." if code else "S", end="", file=sys.stderr, flush=True)
            if name is not None:
                child, answer = self._start(sorted(items, key=self._rank), tree, most_s)
                running[child] = (name, answer)
        print(file=sys.stderr)

    def _rank(self, item: pytest.Item) -> int:
        return -self._kills[item.nodeid]

    def _start(self, items: list[pytest.Item], tree: ast.Module, most_s: int) -> tuple[int, int]:
        """Run the tests on `tree` in a process of its own; its id, and where the name of the test that failed comes."""
        answer, told = os.pipe()
        child = os.fork()
        if child:
            os.close(told)
            return child, answer
        code = 70
        with contextlib.suppress(Exception):
            null = os.open(os.devnull, os.O_WRONLY)
            os.dup2(null, 1)
            os.dup2(null, 2)
            signal.setitimer(signal.ITIMER_VIRTUAL, most_s)
            signal.alarm(WAIT_S)
            put_in_place(self._module, tree)
            failed = first_failure(items)
            os.write(told, failed.encode())
            code = 1 if failed else 0
        os._exit(code)

    def _end(self, child: int, answer: int, status: int | None = None) -> tuple[str, int]:
        """Who killed it, and its exit code."""
        status = os.waitpid(child, 0)[1] if status is None else status
        with os.fdopen(answer) as told:
            return told.read(), os.waitstatus_to_exitcode(status)


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


def first_failure(items: list[pytest.Item]) -> str:
    """The first of the tests that fails; empty where all pass."""
    for item, following in zip(items, [*items[1:], None], strict=True):
        if any(report.failed for report in runtestprotocol(item, nextitem=following, log=False)):
            return item.nodeid
    return ""


def tried(module: str) -> Mutants:
    """All mutants of a module, with those that have survived."""
    tests, but = TARGETS[module]
    found = Mutants(module)
    code = pytest.main(
        [
            "-q",
            "--capture=no",
            "--hypothesis-profile=mutation",
            "-p",
            "no:xdist",
            "-p",
            "no:rerunfailures",  # a mutant's failure is no accident
            "-o",
            "markers=flaky: as of rerunfailures\nxdist_group: as of xdist",
            "-m",
            "not live",
            *(str(ROOT / file) for file in tests.split()),
            *([f"--deselect={tests}::{but}"] if but else []),
        ],
        plugins=[found],
    )
    if code:
        sys.exit(f"{module}: the tests could not be run (exit code {int(code)})")
    return found


def run(asked: Asked) -> Report:
    """All modules, or the one that `only` names."""
    os.chdir(ROOT)
    reasons = {
        (entry["module"], mutant): entry["reason"]
        for entry in tomllib.loads(EQUIVALENT.read_text())["equivalent"]
        for mutant in entry.get("mutants", [entry.get("mutant")])
    }
    report, rows = Report(), []
    for module in [asked.only] if asked.only else TARGETS:
        found = tried(module)
        names, alive = {name for name, _ in found.cases}, set(found.alive)
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
