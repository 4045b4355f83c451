"""The faults of a GCS controller and of a tracker by UDP that the campaign tries, on config/gcs.yaml."""

from __future__ import annotations

import signal

from .cases import CUT_OFF, LINK, STUCK, Case, inject, kill, tell

_LOST = ("X-301",)
"""The reference is missed after 500 ms, by the limits of a simulation."""

CASES = (
    Case("2 % of the replies missing", inject("drop", driver="piezo", share=0.02), counted=("missing_replies",)),
    Case("2 % of the replies 60 ms late", inject("delay", driver="piezo", ms=60, share=0.02)),
    Case("all replies missing", inject("drop", driver="piezo"), CUT_OFF, 300.0, ("missing_replies",)),
    Case("the controller refuses commands", inject("gcs_error", driver="piezo", code=5), CUT_OFF, 300.0, said="error"),
    Case("connection reset", inject("disconnect", driver="piezo"), CUT_OFF, 300.0),
    Case("port gone", inject("unplug", driver="piezo"), CUT_OFF, 300.0),
    Case("controller hangs, connection open", inject("hang", driver="piezo"), CUT_OFF, 300.0),
    Case("10 % of the datagrams lost", inject("drop", driver="tracker", share=0.1)),
    Case("10 % of the datagrams doubled", inject("duplicate", driver="tracker", share=0.1)),
    Case("neighbours swapped", inject("reorder", driver="tracker", share=0.1)),
    Case("datagrams from a stranger's address", inject("stranger", driver="tracker")),
    Case("tracker silent", inject("hang", driver="tracker", for_s=1.0), (*_LOST, LINK), 700.0, lasts_s=1.0),
    Case("value frozen", tell("freeze", signal="strain_x", for_s=1.0), (STUCK,), 700.0, lasts_s=1.0),
    Case("worker killed", kill(signal.SIGKILL), CUT_OFF, 400.0, said="was killed by signal 9; started again"),
)
