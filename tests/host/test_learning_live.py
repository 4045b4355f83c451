"""A memory on the real loop, end to end: recognised, played, learned from, and in the audit trail."""

import os
import signal

import pytest
from learner.production import BEGIN_S, Production, text

from campaigns.running_controller import until
from micromanip.client import Client
from micromanip.design.learning.transfer import DRAWS
from micromanip.rt import mailbox as w
from tests.cells import changed

pytestmark = [
    pytest.mark.live,
    pytest.mark.realtime,  # the path is that of the simulation's own time: a loop that stalls for long leaves it
]

SECONDS, AGAIN_S = 3.0, 12.0
SHARED = (
    ("  cpu: 1                  # the loop's own CPU; null leaves it free\n", "  cpu: null\n"),
    ("spin_us: 60 ", "spin_us: 10 "),
)
# of all three axes, joints included (97, 100 and 103 turns), the path comes again every AGAIN_S
PERIODIC = (
    "    force: {start_s: 2.0,",
    "    deviation: {frequencies_Hz: [0.25, 0.5, 1.0], amplitudes_um: [60, 30, 20], joint_Hz: 8.333333333333334}\n"
    "    force: {start_s: 2.0,",
)


@pytest.mark.thorough  # a minute of the real loop; in virtual time: test_law.py, test_learning_keeper.py
def test_a_memory_is_recognised_played_and_learned_from_on_the_real_loop(run, tmp_path):
    made = changed(text(SECONDS, PERIODIC), *SHARED)
    before = Production(tmp_path, made, DRAWS)
    for seed in (1, 2):
        before.part(seed)
    cell = run(changed(made, ("folder: learned", f"folder: {tmp_path / 'learned'}"))).reach("TRACKING")
    with Client(cell.socket) as client:
        until(lambda: client.learn_status()["axes"]["y"]["may_play"], cell.last_words)
        until(lambda: (cell.status["words"][w.CYCLE] * 1e-4 - BEGIN_S) % AGAIN_S < 0.05, cell.last_words)
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
    cell.end()
