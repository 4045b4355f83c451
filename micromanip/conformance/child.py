"""A process with a driver in it, to be killed and stopped: ``python -m micromanip.conformance.child``.

Its order comes as a line of JSON on standard input; it answers "writing" once it does, or what keeps it from that.
Manners: "in turns" writes the two patterns by turns, as fast as it can; "switched" writes the first at the declared
rates, and the second from SIGUSR1 on.
"""

from __future__ import annotations

import importlib
import itertools
import json
import signal
import sys
from pathlib import Path
from types import FrameType
from typing import Any

from micromanip.bus.driver import BusDriver
from micromanip.bus.errors import LinkError

from .session import Session


def built(order: dict[str, Any]) -> BusDriver:
    """The driver that an order names."""
    kind: Any = importlib.import_module(order["module"])
    for name in order["name"].split("."):
        kind = getattr(kind, name)
    driver: BusDriver = kind(kind.Options.model_validate(order["options"]), Path(order["folder"]))
    return driver


def main() -> None:
    """Write until somebody makes an end of it."""
    order = json.loads(sys.stdin.readline())
    session = Session(built(order))
    try:
        session.open()
    except AssertionError as error:
        print(error, flush=True)  # noqa: T201
        return
    patterns = order["patterns"]
    (_switched if order["manner"] == "switched" else _in_turns)(session, *patterns)


def _in_turns(session: Session, old: list[float], new: list[float]) -> None:
    print("writing", flush=True)  # noqa: T201
    for turn in itertools.count():
        session.perform_all(new if turn % 2 else old)
        session.receive(0.0005)
        session.forget()


def _switched(session: Session, old: list[float], new: list[float]) -> None:
    session.values = old

    def switch(*_: int | FrameType | None) -> None:
        session.values = new

    signal.signal(signal.SIGUSR1, switch)
    print("writing", flush=True)  # noqa: T201
    while True:
        session.run(1.0)
        if any(isinstance(error, LinkError) for error in session.errors):  # unheard for so long, it may give up
            session.driver.close()
            session.open()
        session.forget()


if __name__ == "__main__":
    main()
