"""Thousands of lines of garbage against a running controller: errors for answers, and nothing else happens.

``--garbage N`` says how many (the campaign ``fuzz``: a million).
"""

import json

import pytest

from campaigns.running_controller import Running
from micromanip.rt import mailbox as w
from tests.cells import LEISURELY, WAITING, Talk, changed

from .garbage import lines

pytestmark = pytest.mark.live  # a running controller

BATCH = 200


@pytest.fixture(scope="module")
def waiting(tmp_path_factory):
    cell = Running(tmp_path_factory.mktemp("garbage"), changed(LEISURELY, *WAITING))
    try:
        yield cell.reach("READY")
        assert cell.end() == 0, cell.said
        assert cell.report["faults"] == []
    finally:
        left = cell.kill()
        cell.release()
    assert left == []


@pytest.mark.timeout(7200)
def test_garbage(waiting, request):
    count = request.config.getoption("--garbage")
    saved = waiting.config.read_text()
    kinds = set()
    with Talk(waiting.socket) as talk:
        batch = []
        for number, line in enumerate(lines(seed=5, count=count), start=1):
            batch.append(line)
            if len(batch) < BATCH and number < count:
                continue
            talk.send(b"\n".join(batch) + b"\n")
            for sent in batch:
                answer = talk.hear()
                assert answer is not None, f"the connection is gone after {sent[:200]!r}"
                assert answer["ok"] is False, f"accepted: {sent[:200]!r}"
                assert answer["exit_code"] in (1, 64, 78), (answer, sent[:200])
                assert len(json.dumps(answer)) < 10_000
                kinds.add(answer["error"][:12])
            batch = []
        after = json.loads(json.dumps(talk.ask(b'{"version": 1, "verb": "status"}')))["result"]
    assert len(kinds) > 15, "the garbage is too much alike"
    assert after["state"] == "READY"
    assert after["faults"] == []
    assert after["parameter_version"] == 1
    assert waiting.control["words"][w.COMMAND_NUMBER] == 0
    assert waiting.config.read_text() == saved
    assert "Traceback" not in waiting.said
    waiting.go_on(10)
