"""`micromanip system bench`: one document, and what can't run here is named (its C twin: ``twin/``)."""

import json
import subprocess
import sys

import pytest
from click.testing import CliRunner

from micromanip.cli.main import cli

pytestmark = pytest.mark.compiled_only
KEYS = {"name", "value", "unit", "reference_name", "reference_value", "ratio"}


def bench(*arguments):
    """The command in a process of its own."""
    command = [sys.executable, "-c", "from micromanip.cli.main import main; main()", "system", "bench", *arguments]
    return subprocess.run(command, capture_output=True, text=True, check=False)


@pytest.mark.long
def test_json_is_one_document():
    done = bench("--json", "--only", "offline")
    assert done.returncode == 0
    document = json.loads(done.stdout)
    assert [row["name"] for row in document["results"]] == ["offline"]
    assert set(document["results"][0]) == KEYS
    assert document["skipped"] == []
    assert "offline" in done.stderr


def test_what_this_machine_lacks_is_named(monkeypatch):
    monkeypatch.setenv("PATH", "")
    arguments = ["system", "bench", "--json", "--only", "lateness", "--only", "cycle"]
    document = json.loads(CliRunner().invoke(cli, arguments, catch_exceptions=False).stdout)
    assert document["results"] == []
    assert {entry["name"]: entry["reason"].rsplit(" ", 1)[1] for entry in document["skipped"]} == {
        "cycle": "gcc",
        "lateness": "rt-tests",
    }
