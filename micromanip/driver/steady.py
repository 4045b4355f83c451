"""For a bus driver that is compiled (``BusDriver.steady``): its functions, what they are called with and return."""

from micromanip.rt.entries import steady_entries
from micromanip.rt.io.worker_records import NOTHING_SENT, SENT_IN_DOUBT, UNCONFIRMED
