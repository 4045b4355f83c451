"""The faults of a serial line that the campaign tries, on config/serial.yaml, and what must follow each."""

from __future__ import annotations

import signal

from .cases import CUT_OFF, STRAIN, STUCK, UNFOLLOWED, Case, inject, kill, tell

CASES = (
    Case("1 % of all frames lost", inject("drop", share=0.01), counted=("lost",)),
    Case("one wrong bit in 5 % of the frames", inject("flip", share=0.05), counted=("bad_frames",)),
    Case("rubbish before 5 % of the frames", inject("garbage", share=0.05), counted=("skipped_bytes",)),
    Case("5 % of the frames break off", inject("short", share=0.05), counted=("bad_frames",)),
    Case("all frames in two parts", inject("split", gap_ms=0.2)),
    Case("frames four at a time", inject("join", count=4)),
    Case("10 % of the frames doubled", inject("duplicate", share=0.1), counted=("not_fresh",)),
    Case("board silent, port there", inject("hang"), CUT_OFF, 150.0),
    Case("port unplugged", inject("unplug"), CUT_OFF, 150.0),
    Case("command frames lost, all", inject("drop", direction="received"), UNFOLLOWED, 150.0),
    Case("commands come back (echo)", inject("echo")),
    Case("counter frozen, values running", tell("stop_counter", for_s=0.6), CUT_OFF, 150.0),
    Case("value frozen, counter running", tell("freeze", signal="strain_x", for_s=0.6), (STUCK,), 150.0),
    Case("gauge says NaN: the largest code", tell("nan", signal="strain_x", for_s=0.6), (STRAIN,), 150.0),
    Case("board restarted", tell("reboot", for_s=0.5), CUT_OFF, 150.0),
    Case("worker killed", kill(signal.SIGKILL), CUT_OFF, 400.0, said="was killed by signal 9; started again"),
    Case("worker stopped for 0.5 s", kill(signal.SIGSTOP, 0.5), CUT_OFF, 400.0),
)
