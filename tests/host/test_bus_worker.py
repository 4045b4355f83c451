"""What the host makes of the words of a bus worker."""

from micromanip.host.bus_worker import BusWorker


def test_rights_that_are_refused_are_no_reason_for_a_link_that_is_not_up_yet():
    """Else the first link has little time on a machine without them, and the wrong thing is blamed."""
    worker, said = BusWorker.__new__(BusWorker), []
    worker.name, worker.said, worker._is_slow = "can", "", False
    worker._take({"event": "rights", "text": "no real-time priority"}, said.append)
    assert said == ["WARNING: driver can: no real-time priority"]
    assert worker.said == ""
