"""The suite that every bus driver must pass, for its author's tests: docs/write-a-driver.md goes through it."""

from importlib.util import find_spec

if find_spec("pytest") is None:
    raise ModuleNotFoundError("the conformance suite needs pytest: install pytest beside micromanip")

from micromanip.conformance.contract import BusDriverContract
from micromanip.conformance.peer import Golden, Peer
