"""The runner lists what there is, and each campaign can be run by its name."""

import importlib
import sys
from pathlib import Path

import pytest

from campaigns.__main__ import CAMPAIGNS, main
from campaigns.report import Report

CONTRIBUTING = Path(__file__).parents[2] / "CONTRIBUTING.md"


def typed(monkeypatch, *arguments):
    monkeypatch.setattr(sys, "argv", ["campaigns", *arguments])
    return main()


def test_the_list_has_a_line_and_a_duration_for_each(monkeypatch, capsys):
    assert typed(monkeypatch) == 0
    lines = capsys.readouterr().out.splitlines()
    assert [line.split()[0] for line in lines] == [*CAMPAIGNS]
    assert all(" min  " in line for line in lines)


def test_an_unknown_name_is_told_those_there_are(monkeypatch, capsys):
    assert typed(monkeypatch, "sorprise") == 64
    assert "surprise, kills" in capsys.readouterr().err


@pytest.mark.parametrize("name", [name for name, each in CAMPAIGNS.items() if not each.command and name != "mutation"])
def test_each_has_a_module_that_runs_it(name):  # `mutation` runs without numba, and says so when it is imported
    assert callable(importlib.import_module(f"campaigns.{name}").run)


def test_a_wrong_thing_is_the_exit_code_and_stands_in_the_report(monkeypatch, capsys):
    module = importlib.import_module("campaigns.path")
    monkeypatch.setattr(module, "run", lambda asked: Report({"t": [{"a": 1.0}]}, [], [f"{asked.count} of them"]))
    assert typed(monkeypatch, "path", "--count", "3") == 1
    assert "- 3 of them" in capsys.readouterr().out
