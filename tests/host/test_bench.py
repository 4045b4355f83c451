"""`micromanip system bench`: one document, and what can't run here is named (its C twin: ``twin/``)."""

import json
import subprocess
import sys

import pytest
from click.testing import CliRunner

from micromanip.cli.main import cli

pytestmark = pytest.mark.compiled_only


def bench(*arguments):
    """The command in a process of its own."""
    command = [sys.executable, "-c", "from micromanip.cli.main import main; main()", "system", "bench", *arguments]
    return subprocess.run(command, capture_output=True, text=True, check=False)


def test_what_this_machine_lacks_is_named(monkeypatch):
    monkeypatch.setenv("PATH", "")
    arguments = ["system", "bench", "--json", "--only", "lateness", "--only", "cycle"]
    document = json.loads(CliRunner().invoke(cli, arguments, catch_exceptions=False).stdout)
    assert document["results"] == []
    assert {entry["name"]: entry["reason"].rsplit(" ", 1)[1] for entry in document["skipped"]} == {
        "cycle": "gcc",
        "lateness": "rt-tests",
    }
