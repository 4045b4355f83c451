"""A controller without a loop, and the verbs that speak to it."""

import asyncio
import contextlib
import re

import numpy as np

from campaigns.report import CONFIG
from micromanip.errors import CheckFailed
from micromanip.host.control.audit import AuditTrail
from micromanip.host.control.authority import Peer
from micromanip.host.control.request import Request
from micromanip.host.control.verbs import Verbs
from micromanip.host.recording.recordings import Recordings
from micromanip.host.shared_memory import STATUS
from micromanip.rt import mailbox as w
from micromanip.rt import states
from micromanip.settings.check import prepare

SIMULATED = CONFIG / "paper.yaml"
ALICE = Peer("alice", 1000, 42)


class StandIn:
    """What `Controller` looks like to the verbs; commands follow at once."""

    def __init__(self, prepared, state="TRACKING"):
        self.prepared, self.state = prepared, state
        self.swaps, self.commands, self.offers = [], [], []
        self.injected, self.latched = [], []
        self.status = np.zeros((), STATUS)
        self.shadow(states.NO_SHADOW)

    @contextlib.asynccontextmanager
    async def commanding(self):
        yield

    async def apply(self, prepared):
        await asyncio.sleep(0)
        self.swaps.append(prepared.parameters)
        self.prepared = prepared
        self.shadow(states.NO_SHADOW)
        return self.version

    async def inject(self, parameters):
        self.injected.append(parameters)

    def faults(self):
        return self.latched

    async def offer(self, prepared):
        await asyncio.sleep(0)
        self.offers.append(prepared.parameters)
        self.shadow(states.SHADOWING)
        return self.version

    @property
    def version(self):
        return 1 + len(self.swaps) + len(self.offers)

    def shadow(self, standing):
        """The loop says where the candidate stands."""
        self.status["words"][w.SHADOW] = standing

    async def command(self, command):
        if command in (states.PROMOTE, states.WITHDRAW):
            on_trial = self.status["words"][w.SHADOW] == states.ON_TRIAL
            ended = states.TAKEN_BACK if on_trial else states.NO_SHADOW
            self.shadow(states.ON_TRIAL if command == states.PROMOTE else ended)
            return
        if command == states.RESET and self.state != "FAULT":
            raise CheckFailed(f"reset refused: the state is {self.state}")
        self.commands.append(command)
        self.state = {states.ARM: "ARMING", states.DISARM: "RAMPING", states.HOLD: "HOLDING"}[command]

    @property
    def axes(self):
        """Parameters of the axes as the loop has them."""
        return (self.swaps or [self.prepared.parameters])[-1][0]["axis"]


class Cell:
    """Verbs on a stand-in controller that runs the file `config`."""

    def __init__(self, folder, text=None, state="TRACKING"):
        self.config = folder / "cell.yaml"
        self.config.write_text(text or SIMULATED.read_text())
        self.controller = StandIn(prepare(self.config), state)
        self.said, self.told, self.operated = [], [], []
        self.trail = AuditTrail(folder / "state", self.said.append)
        self.verbs = Verbs(
            self.controller,
            self.trail,
            lambda: {"state": self.controller.state},
            self._settle,
            self.told.append,
            lambda told: self.said.append(str(told)),
            Recordings(self.controller, folder / "recordings", self.said.append),
            lambda request: self.operated.append(request.verb),
        )
        self.table = self.verbs.table()

    async def _settle(self):
        self.said.append("settled")

    def __call__(self, verb, **fields):
        return asyncio.run(self.table[verb].act(Request(verb, fields, ALICE)))

    def follow(self):
        """What the daemon does now and then."""
        asyncio.run(self.verbs.follow())

    def value(self, key):
        (parameter,) = self("get", keys=[key])
        return parameter["value"]

    @property
    def entries(self):
        """The audit trail as (verb, accepted, {key: (old, new)}, reason)."""
        return [
            (e["verb"], e["accepted"], {c["key"]: (c["old"], c["new"]) for c in e["changes"]}, e["reason"])
            for e in self.trail.last(100)["entries"]
        ]


def jogging():
    """The tuned configuration, but its axes are jogged."""
    text = SIMULATED.read_text()
    reference = "reference: {source: jog, offset_um: 60, range_um: [20, 110]}  # by hand\n"
    text, references = re.subn(r"(?m)^reference:.*\n(  .*\n)+", reference, text)
    text, modes = re.subn("    mode: stage  ", "    mode: strain ", text)
    assert (references, modes) == (1, 3)
    return text
