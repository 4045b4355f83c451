"""A memory on the real loop, end to end: recognised, played, learned from, and in the audit trail."""

import os
import signal

import pytest
from learner import production

from micromanip.client import Client
from micromanip.rt import mailbox as w
from tools.running_controller import changed, until

pytestmark = [
    pytest.mark.live,
    pytest.mark.realtime,  # the path is that of the simulation's own time: a loop that stalls for long misses it
]

SECONDS, BEGIN_S = 3.0, 8.0
SHARED = (
    ("  cpu: 1                  # the loop's own CPU; null leaves it free\n", "  cpu: null\n"),
    ("spin_us: 60 ", "spin_us: 10 "),
)


def test_a_memory_is_recognised_played_and_learned_from_on_the_real_loop(run, tmp_path, monkeypatch):
    monkeypatch.setattr(production, "BEGIN_S", BEGIN_S)
    text = changed(production.text(SECONDS), *SHARED)
    before = production.Production(tmp_path, text)
    for seed in (1, 2):
        before.part(seed)
    cell = run(text).reach("TRACKING")
    with Client(cell.socket) as client:
        until(lambda: client.learn_status()["state"] == "learning", cell.last_words)
        until(lambda: client.learn_status()["axes"]["y"]["may_play"], cell.last_words)
        until(lambda: cell.status["words"][w.CYCLE] >= BEGIN_S * 1e4, cell.last_words)
        client.part_begin()
        until(lambda: client.learn_status()["axes"]["y"]["state"] == "plays", cell.last_words)
        until(lambda: client.learn_status()["axes"]["y"]["state"] != "plays", cell.last_words)
        assert client.learn_status()["axes"]["y"]["state"] == "finished", cell.last_words()
        until(lambda: client.learn_status()["made"] == 1, cell.last_words)
        last = client.learn_status()["axes"]["y"]["last"]
        assert last is None or last["generation"] == 3
        assert last is not None or "cycles were missed" in cell.said
        entries = [each for each in client.audit(50)["entries"] if each["verb"] in ("learn", "part_begin")]
        assert {each["verb"] for each in entries} == {"learn", "part_begin"}
        os.kill(cell.child_of("micromanip.learner.process"), signal.SIGKILL)
        until(lambda: "the learning process died; it is started again" in cell.said, cell.last_words)
        client.learn_reset("y")
        until(lambda: client.learn_status()["axes"]["y"]["generation"] is None, cell.last_words)
        until(lambda: not (tmp_path / "learned" / "y.npz").exists(), cell.last_words)
