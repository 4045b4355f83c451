"""A memory on the real loop, end to end: played, learned from, in the audit trail, and forgotten."""

import os
import signal

import pytest
from click.testing import CliRunner
from learner.production import BEGIN_S, Production, text

from campaigns.running_controller import until
from micromanip.cli.commands import cli
from micromanip.client import Client
from micromanip.rt import mailbox as w
from tests.cells import changed

pytestmark = [
    pytest.mark.live,
    pytest.mark.realtime,  # the path is that of the simulation's own time: a loop that stalls for long leaves it
]

SECONDS, AGAIN_S = 3.0, 12.0
BUSY = ("finished", "broken off", "path left")
"""Where other programs stall the loop, its calm gains end what is played; the part counts all the same."""
SHARED = (
    ("  cpu: 1                  # the loop's own CPU; null leaves it free\n", "  cpu: null\n"),
    ("spin_us: 60 ", "spin_us: 10 "),
)
# slow, as a command comes late on a busy machine; of all three axes the path comes again every AGAIN_S
SLOW = (
    "    force: {start_s: 2.0,",
    "    deviation: {frequencies_Hz: [0.25, 0.5, 1.0], amplitudes_um: [4, 2, 1], joint_um: 0.0}\n"
    "    force: {start_s: 2.0,",
)


@pytest.mark.thorough  # a minute of the real loop; in virtual time: tests/learner, test_learning_service.py
def test_a_memory_is_played_and_learned_from_on_the_real_loop(run, tmp_path):
    made = changed(text(SECONDS, SLOW), *SHARED)
    before = Production(tmp_path, made, draws=40)
    for seed in (1, 2):
        before.part(seed)
    cell = run(changed(made, ("folder: learned", f"folder: {tmp_path / 'learned'}"))).reach("TRACKING")

    def typed(*words):
        found = CliRunner().invoke(cli, ["learn", *words, "--socket", str(cell.socket)])
        assert found.exit_code == 0, found.output
        return found.stdout

    with Client(cell.socket) as client:

        def y():
            return client.learn_status()["axes"]["y"]

        until(lambda: y()["may_play"], cell.last_words)
        until(lambda: (cell.status["words"][w.CYCLE] * 1e-4 - BEGIN_S) % AGAIN_S < 0.02, cell.last_words)
        typed("part", "begin")
        until(lambda: y()["state"] == "plays", cell.last_words)
        until(lambda: y()["state"] != "plays", cell.last_words)
        assert y()["state"] in BUSY, cell.last_words()
        until(lambda: client.learn_status()["made"] == 1, cell.last_words)
        last = y()["last"]
        assert last is None or last["generation"] == 3
        assert last is not None or "cycles were missed" in cell.said
        assert {each["verb"] for each in client.log(50)["entries"]} >= {"learn", "learn_part_begin"}
        os.kill(cell.child_of("micromanip.learner.process"), signal.SIGKILL)
        until(lambda: "the learning process died; it is started again" in cell.said, cell.last_words)
        typed("reset", "--axis", "y")
        until(lambda: y()["generation"] is None, cell.last_words)
        until(lambda: not (tmp_path / "learned" / "y.npz").exists(), cell.last_words)
        assert "memories in" in typed("status")
    cell.end()
