"""The suite that every bus driver must pass; a driver's author subclasses ``BusDriverContract``.

``docs/bus-drivers.md`` goes through it step by step. It needs pytest, and no hardware: the author writes a ``Peer``
that speaks the device's protocol. What the worker does with a driver (safe state, reconnection) is not its subject.
"""

from .contract import BusDriverContract
from .peer import Golden, Peer

__all__ = ["BusDriverContract", "Golden", "Peer"]
