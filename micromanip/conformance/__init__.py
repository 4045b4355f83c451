"""The suite that every bus driver must pass; a driver's author subclasses ``BusDriverContract``.

``docs/write-a-driver.md`` goes through it step by step. It needs pytest, and no hardware: the author writes a ``Peer``
that speaks the device's protocol. What the worker does with a driver (safe state, reconnection) is not its subject.
``micromanip.driver.conformance`` is the door to it; nothing is imported here, since the processes that the suite kills
(``child.py``) want no pytest, which is a third of their start.
"""
