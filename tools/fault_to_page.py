"""``python -m tools.fault_to_page [FAULTS]``: how long after its cycle a fault is read on the cell page.

A controller at 10 kHz, a gateway and a headless Chromium with the cell page, a process each as for people. The loop is
stopped for a moment (SIGSTOP): the first cycle after that latches X-102, and its row says when it was. The page notes
when the message with that cycle came, when its text stood in the document, and when the next frame was drawn. All
times are CLOCK_MONOTONIC, of which a page's clock differs by a constant; that is measured before each fault, to half of
the fastest of some questions. Ends with 1 where a fault is not read within 200 ms.
"""

import json
import os
import random
import sys
import tempfile
import time
from contextlib import suppress
from pathlib import Path

import numpy as np

from micromanip.bus.rights import go_before_ordinary_work
from micromanip.client import Client

from .chromium import PROGRAM, chromium
from .running_controller import WAITING, Running, calm, reset, rows_of, until
from .running_gateway import RunningGateway

FAULTS = 40
LIMIT_MS = 200.0
STOPPED_S = 0.08
PRECEDENCE = -15
"""Nice value of gateway and browser, where that is allowed: of interest is the way, not who else is busy here."""
_CONFIGURATION = calm(*WAITING) + "\nfaults: {deadline: {in_a_row: 400, reaction: hold}}\n"
_QUESTIONS = 30
_OVERTAKEN = 20_000
"""The oldest rows of the ring, which the loop overwrites while they are read."""

# Before any script of the page: note when a message with a fault comes, when its text is there, when it is drawn.
_NOTES = """
window.notes = {};
const note = (cycle, what) => { const at = notes[cycle] ??= {}; at[what] ??= performance.now(); };
window.WebSocket = class extends WebSocket {
  constructor(...told) {
    super(...told);
    this.addEventListener("message", (event) => {
      if (typeof event.data !== "string") return;
      for (const fault of JSON.parse(event.data).status?.fault_reports ?? []) note(fault.cycle, "came");
    });
  }
};
document.addEventListener("DOMContentLoaded", () => {
  const faults = document.getElementById("faults");
  new MutationObserver(() => {
    const cycle = faults.hidden ? null : faults.textContent.match(/cycle (\\d+)/)?.[1];
    if (!cycle || notes[cycle]?.read) return;
    note(cycle, "read");
    requestAnimationFrame(() => { const told = new MessageChannel(); told.port1.onmessage = () => note(cycle, "drawn"); told.port2.postMessage(0); });
  }).observe(faults, { childList: true, subtree: true, attributes: true });
});
"""  # noqa: E501


def clock_ms(page):
    """What CLOCK_MONOTONIC is ahead of the page's clock, and by how much that may be wrong."""
    found = []
    for _ in range(_QUESTIONS):
        before = time.monotonic_ns()
        there = page.value("performance.now()")
        after = time.monotonic_ns()
        found.append(((after - before) * 0.5e-6, (before + after) * 0.5e-6 - there))
    half, ahead = min(found)
    return ahead, half


def opened(page, gateway):
    """The cell page, with a token that looks."""
    page("Page.addScriptToEvaluateOnNewDocument", source=_NOTES)
    page("Page.navigate", url=f"http://{gateway.host}/")
    page.until("document.querySelector('dialog[open] #token') !== null")
    page.value(f"document.getElementById('token').value = '{gateway.secret['observe']}'")
    page.value("document.querySelector('dialog[open] button').click()")
    page.until("document.querySelector('#state b').textContent === 'READY'")


def one(cell, page, client):
    """Of one fault: ms from its cycle to the message, to the text, to the drawing; how wrong the clocks may be."""
    ahead, half = clock_ms(page)
    cell.stall(STOPPED_S)
    until(lambda: cell.state == "FAULT", cell.last_words)
    rows = rows_of(cell.ring)[_OVERTAKEN:]
    latched_ns = int(rows["time_ns"][np.argmax(rows["fault"] != 0)])
    notes = f"window.notes[{client.status()['fault_reports'][0]['cycle']}]"
    page.until(f"{notes}?.drawn > 0")
    at = json.loads(page.value(f"JSON.stringify({notes})"))
    found = [at[what] + ahead - latched_ns * 1e-6 for what in ("came", "read", "drawn")]
    reset(client)
    page.until("document.getElementById('faults').hidden")
    cell.go_on(70_000)  # no row of this fault is in the ring any more
    time.sleep(random.random() * 0.5)  # no fault falls together with what is done at intervals
    return [*found, half]


def main(faults):
    """1 where one is not read in time."""
    if PROGRAM is None:
        print("chromium is not installed")
        return 1
    goes_before = go_before_ordinary_work(PRECEDENCE)
    print("gateway and browser " + (f"with nice {PRECEDENCE}" if goes_before else "as ordinary work"), flush=True)
    with tempfile.TemporaryDirectory() as name, chromium(Path(name) / "chromium") as page:
        cell = Running(Path(name), _CONFIGURATION)
        gateway = None
        try:
            cell.reach("READY")
            gateway = RunningGateway(cell)
            opened(page, gateway)
            with Client(cell.socket) as client:
                found = []
                for k in range(faults):
                    found.append(one(cell, page, client))
                    print(f"{k + 1} of {faults}: " + ", ".join(f"{ms:.1f}" for ms in found[-1][:3]) + " ms", flush=True)
        finally:
            if gateway is not None:
                gateway.close()
            with suppress(Exception):
                cell.end()
            cell.kill()
            cell.release()
    return told(np.array(found))


def told(found):
    """Print percentiles; 1 where one is beyond the limit."""
    print(
        f"{len(found)} faults, load {os.getloadavg()[0]:.1f}, clocks to {found[:, 3].max():.1f} ms; ms after the cycle"
    )
    steps = {
        "message there": found[:, 0],
        "text in the page": found[:, 1],
        "drawn": found[:, 2],
        "of these in the page": found[:, 2] - found[:, 0],
    }
    for what, ms in steps.items():
        figures = zip(("least", "p50", "p90", "p95", "most"), np.percentile(ms, (0, 50, 90, 95, 100)), strict=True)
        print(f"{what:20} " + ", ".join(f"{name} {figure:6.1f}" for name, figure in figures))
    late = int((found[:, 1] > LIMIT_MS).sum())
    print(f"{late} of {len(found)} later than {LIMIT_MS:g} ms")
    return 1 if late else 0


if __name__ == "__main__":
    sys.exit(main(int(sys.argv[1]) if len(sys.argv) > 1 else FAULTS))
