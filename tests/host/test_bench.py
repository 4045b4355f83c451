"""`micromanip system bench`: what can't run here is named."""

import json

import pytest
from click.testing import CliRunner

from micromanip.cli.main import cli

pytestmark = pytest.mark.compiled_only


def test_what_this_machine_lacks_is_named(monkeypatch):
    monkeypatch.setenv("PATH", "")
    arguments = ["system", "bench", "--json", "--only", "lateness", "--only", "cycle"]
    document = json.loads(CliRunner().invoke(cli, arguments, catch_exceptions=False).stdout)
    assert document["results"] == []
    assert {entry["name"]: entry["reason"].rsplit(" ", 1)[1] for entry in document["skipped"]} == {
        "cycle": "gcc",
        "lateness": "rt-tests",
    }
