"""Bars: how far they are, and that nothing is shown where nobody looks."""

import ast
import contextlib
import inspect
import io

import numpy as np
import pytest
from rich.console import Console
from rich.progress import Progress

from micromanip.cli.progress import Steps, steps
from micromanip.design.commission import axis as commission_axis
from micromanip.design.commission import cell as commission_cell
from micromanip.design.commission import closing


@contextlib.contextmanager
def shown(plan=()):
    with Progress(console=Console(file=io.StringIO()), disable=True) as bar:
        yield Steps(bar, plan), lambda: bar.tasks[0]


def test_a_plan_counts_by_the_time_that_its_steps_take():
    with shown([("look", 1.0), ("fit", 6.0), ("write", 3.0)]) as (bar, task):
        parts = []
        for what in ("look", "something else", "fit", "write"):
            bar.say(what)
            parts.append(task().percentage)
        assert parts == pytest.approx([0, 0, 10, 70])
        assert task().description == "write"


def test_a_step_that_comes_twice_does_not_go_back():
    with shown([("a", 1.0), ("b", 1.0), ("a", 1.0), ("c", 1.0)]) as (bar, task):
        for what, percent in (("a", 0), ("b", 25), ("a", 50), ("b", 50), ("c", 75)):
            bar.say(what)
            assert task().percentage == pytest.approx(percent)


def test_without_a_plan_the_work_says_how_far_it_is():
    with shown() as (bar, task):
        bar.say("recording")
        assert task().total is None
        bar.say("axis x: plant 51 of 200")
        assert (task().completed, task().total) == (50, 200)
        bar.say("axis x: cell 1 of 8")
        assert (task().completed, task().total) == (0, 8)
        bar.say("drawing")
        assert task().total is None


def test_nothing_is_written_where_standard_error_is_no_terminal(capsys):
    with steps([("look", 1.0)]) as bar:
        bar.say("look")
    assert capsys.readouterr() == ("", "")


def test_the_plan_of_commissioning_has_every_step_that_is_said(monkeypatch):
    """So that a step which is renamed does not fall out of the bar."""
    names = [name.partition(": ")[2] for name, _ in commission_cell.planned(["x"]) if name.startswith("axis x")]
    said = [constant for module in (commission_axis, closing, commission_cell) for constant in _said(module)]
    assert set(said) <= {*names, "the cell at rest", "as it will run"}
    assert set(names) <= set(said)
    assert np.unique(names).size == len(names)


def _said(module):
    for node in ast.walk(ast.parse(inspect.getsource(module))):
        if isinstance(node, ast.Call) and getattr(node.func, "id", "") in ("say", "_of"):
            yield from (each.value for each in node.args if isinstance(each, ast.Constant))
