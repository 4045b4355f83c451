"""The host arms by itself with sensors that are late: waited for, told, bounded; over with anybody's no, for good."""

import asyncio

import pytest

from campaigns.report import CONFIG
from campaigns.running_controller import until
from micromanip.client import Client
from micromanip.errors import CheckFailed
from micromanip.host import arming as module
from micromanip.host.arming import HostArming
from micromanip.host.control.authority import Peer
from micromanip.host.control.request import Request
from micromanip.host.controller import Controller
from micromanip.rt import mailbox as w
from micromanip.rt import states
from micromanip.settings.check import prepare
from tests.cells import QUICK, simulated

from .standin import Cell

SIMULATED = CONFIG / "simulated.yaml"
ALICE = Peer("alice", 1000, 42)


class Arming:
    """A controller in READY whose loop refuses to arm for what `lacks` says, and what came of it."""

    def __init__(self, folder):
        self.controller = Controller(prepare(SIMULATED), folder / "none.sock")
        self.controller.words[w.STATE], self.controller.words[w.CYCLES_RUN] = states.READY, 3
        self.cell = self.controller.status["state"][0]
        self.orders, self.noted, self.said = [], [], []
        self.arming = HostArming(self.controller, self._note, self.said.append)

    async def _note(self, changes, reason=None):
        self.noted.append(reason or changes[0]["new"])

    def lack(self, cell=0, *, x=0):
        self.cell["refused"], self.cell["arming"]["refused"][0] = cell, x

    async def obey(self):
        """The loop's side of the commands."""
        while True:
            number = self.controller.control["words"][w.COMMAND_NUMBER]
            if number != self.controller.words[w.COMMAND_DONE]:
                self.orders.append(int(self.controller.control["words"][w.COMMAND]))
                refused = self.cell["refused"] or self.cell["arming"]["refused"][0]
                self.controller.words[w.COMMAND_ACCEPTED] = not refused
                if not refused:
                    self.controller.words[w.STATE] = states.ARMING
                self.controller.words[w.COMMAND_DONE] = number
            await asyncio.sleep(0)

    def __call__(self, then=lambda: None):
        """READY: what comes of it; `then` happens once it waits."""

        async def life():
            loop = asyncio.create_task(self.obey())
            self.controller.declare_ready()
            arming = asyncio.create_task(self.arming.arm(lambda: False))
            for _ in range(2000):
                if self.said or arming.done():
                    break
                await asyncio.sleep(0.001)
            if not arming.done():
                then()
            try:
                await arming
            finally:
                loop.cancel()

        asyncio.run(life())
        return self.controller.state


@pytest.fixture
def ready(tmp_path, monkeypatch):
    monkeypatch.setattr(module, "_LOOK_S", 0.005)
    return lambda: Arming(tmp_path)


def test_where_nothing_is_missing_it_arms_at_once_and_says_nothing(ready):
    cell = ready()
    assert cell() == "ARMING"
    assert (cell.orders, cell.noted, cell.said) == ([states.ARM], ["ARMING"], [])


def test_a_late_sensor_is_waited_for_and_said(ready):
    cell = ready()
    cell.lack(x=states.STRAIN_MISSING | states.STAGE_MISSING)
    assert cell(cell.lack) == "ARMING"
    assert len(cell.said) == 1
    assert "arms by itself as soon as it can, within 30 s: `micromanip disarm` calls it off" in cell.said[0]
    assert "strain_x is not valid" in cell.said[0]
    assert "stage_x is silent" in cell.said[0]
    assert cell.noted == ["ARMING"]


def test_it_gives_up_for_good(ready, monkeypatch):
    monkeypatch.setattr(module, "ARMS_WITHIN_S", 0.1)
    cell = ready()
    cell.lack(x=states.REFERENCE_MISSING)
    with pytest.raises(CheckFailed, match=r"^arm refused: deviation_x is not fresh.*gave up after 0.1 s") as failed:
        cell()
    assert cell.noted == [str(failed.value)]
    assert cell.controller.state == "READY"


@pytest.mark.parametrize("verb", ["disarm", "arm", "hold", "reset", "set", "jog"])
def test_whoever_operates_the_cell_meanwhile_has_it(ready, verb):
    """What comes afterwards arms nothing."""
    cell = ready()
    cell.lack(x=states.STRAIN_MISSING)

    def acts():
        cell.arming.leave_to(Request(verb, {}, ALICE))
        cell.lack()

    assert cell(acts) == "READY"
    assert cell.said[-1] == f"arming is called off by `{verb}` of alice: only `micromanip arm` arms now"
    assert cell.noted == []


@pytest.mark.parametrize("bits", [states.LATCHED, states.NOT_READY, states.LINK_MISSING, states.OUTPUTS_MISSING])
def test_a_fault_or_a_lost_link_meanwhile_is_not_waited_out(ready, bits):
    cell = ready()
    cell.lack(x=states.STRAIN_MISSING)
    with pytest.raises(CheckFailed, match=r"^arm refused"):
        cell(lambda: cell.lack(bits, x=states.STRAIN_MISSING))
    assert cell.controller.state == "READY"


def said(line, value, *, bad=0, time_ns=1):
    line["value"], line["bad"], line["time_ns"] = value, bad, time_ns


@pytest.mark.parametrize(
    ("value", "bad"), [(0.0, 0), (1.0, 3)], ids=["an emergency stop that is pressed", "a wire that was cut"]
)
def test_a_line_that_says_no_is_not_waited_out(ready, value, bad):
    """Releasing an emergency stop must not start anything by itself (EN ISO 13850)."""
    for bit, name in ((states.ENABLE_MISSING, "enable"), (states.INTERLOCK_MISSING, "interlock")):
        cell = ready()
        cell.lack(bit)
        said(cell.cell[name], value, bad=bad)
        with pytest.raises(CheckFailed, match=f"the signal {name} is not 1"):
            cell()
    cell = ready()
    cell.lack(x=states.AMPLIFIER_MISSING)
    said(cell.cell["axis"][0]["amplifier_ok"], value, bad=bad)
    with pytest.raises(CheckFailed, match="amplifier_ok_x is not 1"):
        cell()


def test_verbs_tell_who_operates_but_not_who_looks_or_records(tmp_path):
    cell = Cell(tmp_path, state="READY")
    for verb, fields in (("status", {}), ("get", {"keys": ["axes.x.inner"]}), ("diff", {}), ("candidate_show", {})):
        cell(verb, **fields)
    with pytest.raises(CheckFailed):
        cell("recording_stop")
    assert cell.operated == []
    cell("set", changes={"axes.x.inner.K_V_per_um": 0.25})
    with pytest.raises(CheckFailed):
        cell("reset")  # also what is refused shows that somebody is there
    cell("disarm")
    assert cell.operated == ["set", "reset", "disarm"]


LATE = ("    seed: 1\n", "    seed: 1\n    faults: [{channel: strain_x, kind: drop, at_s: 0, for_s: 4}]\n")


def test_a_controller_waits_for_a_gauge_that_is_late(run):
    """And its duration begins when it has armed: what was waited for does not count."""
    cell = run(simulated(*QUICK, LATE), "--duration", "1.5").reach("READY")
    with Client(cell.socket) as client:
        until(lambda: client.status()["state"] == "ARMING", cell.last_words)
    assert "arms by itself as soon as it can" in cell.said
    assert "strain_x is not valid" in cell.said
    assert cell.wait() == 0
    assert cell.report["cycles"] * 1e-4 > 4.0 + 1.5
    assert cell.report["state"] == "OFF"
