"""Bars: how far they are, and that nothing is shown where nobody looks."""

import ast
import inspect

import numpy as np

from micromanip.cli.progress import steps
from micromanip.design.commission import axis as commission_axis
from micromanip.design.commission import cell as commission_cell
from micromanip.design.commission import closing


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
