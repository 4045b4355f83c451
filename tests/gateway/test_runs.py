"""The catalogue over HTTP: questions and what makes none, reports by ticket, files that are none of its business."""

import asyncio
import json
import shutil
import sys
from pathlib import Path

import pytest

from micromanip.gateway import runs as runs_module
from micromanip.gateway.app import Gateway
from micromanip.gateway.guard import Origins
from micromanip.gateway.runs import Runs
from micromanip.gateway.tokens import Token, Tokens
from tests.catalogue.test_runs import report

from .asgi import request
from .rings import Played

SEE = "s" * 24
CONFIG = Path(__file__).parents[2] / "config" / "simulated.yaml"


@pytest.fixture
def folder(tmp_path):
    """A report, a tuning, and a recording that is damaged."""
    made = tmp_path / "recorded"
    made.mkdir()
    report(made / "report.html", [True, False])
    shutil.copy(CONFIG, made / "tuned.yaml")
    (made / "cut.mcap").write_bytes(b"nothing")
    return made


def hasty(module):
    """The process, at the priority of the tests: on a busy machine it would hardly come to its turn."""
    start = "import sys, micromanip.catalogue.background as b; b.give_way = lambda: None; "
    start += f"from micromanip.catalogue import {module} as m; sys.exit(m.main(sys.argv[1:]))"
    return [sys.executable, "-c", start]


@pytest.fixture
def app(tmp_path, folder, monkeypatch):
    monkeypatch.setattr(runs_module, "_command", hasty)
    cell = Played(tmp_path / "control.sock").cell
    runs = Runs(tmp_path / "state", [folder])
    return Gateway(cell, Tokens([Token("screen", "observe", SEE)]), Origins(), lambda: None, runs=runs).guard


async def asked(app, path, told, code=200):
    found, _, body = await request(app, path, method="POST", body=told, token=SEE)
    assert found == code, body
    return json.loads(body)


async def looked_through(app, **told):
    async with asyncio.timeout(120):
        while (answer := await asked(app, "/api/runs", told))["refreshing"]:
            await asyncio.sleep(0.05)
    return answer


@pytest.mark.live
def test_files_are_found_read_by_another_process_and_reports_opened(app, folder):
    async def do():
        first = await asked(app, "/api/runs", {})
        assert (first["found"], first["refreshing"]) == ([], True)
        answer = await looked_through(app)
        assert (answer["problem"], answer["entries"]) == (None, 3)
        assert str(folder) in answer["folders"]
        by_kind = {entry["kind"]: entry for entry in answer["found"]}
        assert by_kind.keys() == {"report", "tuning", "recording"}
        assert by_kind["recording"]["problem"]
        assert [e["kind"] for e in (await looked_through(app, kind="tuning"))["found"]] == ["tuning"]
        assert (await looked_through(app, text="no such words"))["found"] == []

        address = (await asked(app, "/api/runs/report", {"path": str(folder / "report.html")}))["address"]
        code, headers, body = await request(app, address)
        assert (code, body) == (200, (folder / "report.html").read_bytes())
        assert headers["content-security-policy"].startswith("default-src 'none'; style-src 'unsafe-inline'")
        assert (await request(app, address[:-1]))[0] == 404
        for path in (folder / "tuned.yaml", "/etc/passwd", folder / ".." / "recorded" / "report.html", "", None):
            told = {"path": path if path is None else str(path)}
            assert "that the catalogue has" in (await asked(app, "/api/runs/report", told, 400))["error"]
        failed = await asked(app, "/api/runs/report", {"path": str(folder / "cut.mcap")}, 409)
        assert "cut.mcap" in failed["error"]

    asyncio.run(do())


@pytest.mark.parametrize(
    ("told", "said"),
    [
        ({"sort": "began; DROP"}, "sort is one of"),
        ({"kind": "all"}, "kind is one of"),
        ({"text": 5}, "text is a text"),
        ({"text": "x" * 1001}, "text is a text"),
        ({"above_um": "1"}, "above_um is a number"),
        ({"most": 5000}, "most is a number"),
        ({"folder": "/etc"}, "a question has no 'folder'"),
    ],
)
def test_questions_that_make_no_sense_are_told(app, told, said):
    assert said in asyncio.run(asked(app, "/api/runs", told, 400))["error"]


def test_without_a_token_or_a_catalogue_nothing_is_told(app, tmp_path):
    for path in ("/api/runs", "/api/runs/report"):
        assert asyncio.run(request(app, path, method="POST", body={}))[0] == 401
    cell = Played(tmp_path / "control.sock").cell
    bare = Gateway(cell, Tokens([Token("screen", "observe", SEE)]), Origins(), lambda: None).guard
    assert "no catalogue" in asyncio.run(asked(bare, "/api/runs", {}, 400))["error"]
