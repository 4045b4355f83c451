"""For a bus driver that is compiled (``BusDriver.steady``): what its two functions are called with, and return."""

from micromanip.rt.steady.records import INBOX, NOTHING_SENT, SENT_IN_DOUBT, UNCONFIRMED

__all__ = ["INBOX", "NOTHING_SENT", "SENT_IN_DOUBT", "UNCONFIRMED"]
