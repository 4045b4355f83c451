"""What a campaign finds wrong is its exit code."""

import importlib
import sys

from campaigns.__main__ import main
from campaigns.report import Report


def typed(monkeypatch, *arguments):
    monkeypatch.setattr(sys, "argv", ["campaigns", *arguments])
    return main()


def test_a_wrong_thing_is_the_exit_code_and_stands_in_the_report(monkeypatch, capsys):
    module = importlib.import_module("campaigns.path")
    monkeypatch.setattr(module, "run", lambda asked: Report({"t": [{"a": 1.0}]}, [], [f"{asked.count} of them"]))
    assert typed(monkeypatch, "path", "--count", "3") == 1
    assert "- 3 of them" in capsys.readouterr().out
