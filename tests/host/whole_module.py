"""A controller that tracks for all tests of a module, and ends as it should behind them."""

import contextlib

from campaigns.running_controller import Running
from tests.cells import changed

PATIENT = "host: {silent_ms: 10000}"
"""On a machine that is busy with other tests the host may be late."""


def patient(text):
    """The cell of `text`, in no hurry to hear from its host."""
    if "\nfaults: {" in text:
        return changed(text, ("\nfaults: {", f"\nfaults: {{{PATIENT}, "))
    return f"{text}\nfaults: {{{PATIENT}}}\n"


@contextlib.contextmanager
def tracking_until_the_end(folder, text):
    """It is handed out once it tracks; no test may have made it fault, complain, or leave a process behind."""
    cell = Running(folder, patient(text))
    try:
        yield cell.reach("TRACKING")
        assert cell.end() == 0, cell.said
        assert "Traceback" not in cell.said
        assert cell.report["faults"] == []
    finally:
        left = cell.kill()
        cell.release()
    assert left == []
