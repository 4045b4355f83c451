"""The full screen of ``status --watch``, drawn with textual.

A thread asks the controller, and `call_later` hands on what it answers; the screen never waits.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import ClassVar

from rich.console import RenderableType
from rich.text import Text
from textual.app import App, ComposeResult
from textual.binding import Binding, BindingType
from textual.containers import Vertical, VerticalScroll
from textual.screen import ModalScreen
from textual.widgets import Footer, Static

from micromanip.client import Client
from micromanip.errors import DeviceUnavailable, MicromanipError
from micromanip.status_reply import Status

from .live import details, one_line

LOOK_S = 0.2
_COLOURS = {
    "TRACKING": ("#ffffff", "#0a6b2d"),
    "READY": ("#ffffff", "#1f4e99"),
    "FAULT": ("#ffffff", "#c01818"),
    "HOLDING": ("#000000", "#e0b000"),
    "RAMPING": ("#000000", "#e0b000"),
    "ARMING": ("#000000", "#e0b000"),
}
"""Text and background."""
_OTHER = ("#ffffff", "#444444")
_ORDERS: dict[str, tuple[Callable[[Client], None], str]] = {
    "arm": (Client.arm, "Arm the cell? It begins to move."),
    "hold": (Client.hold, "Hold? The correction is frozen where it is."),
    "disarm": (Client.disarm, "Disarm? Every output ramps to its park voltage."),
    "reset": (Client.reset, "Clear the latched fault? Nothing moves."),
}


class Question(ModalScreen[bool]):
    """Asks before anything is sent; only y means yes."""

    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("y", "answer(True)", "yes"),
        Binding("n,escape,enter,q", "answer(False)", "no"),
    ]
    CSS = """
    Question { align: center middle; }
    #question { width: auto; max-width: 90%; height: auto; border: thick $warning; padding: 1 2; background: $surface; }
    """

    def __init__(self, question: str) -> None:
        super().__init__()
        self._question = question

    def compose(self) -> ComposeResult:
        yield Static(f"{self._question}\n\n(y) yes   (n) no", id="question", markup=False)

    def action_answer(self, answer: bool) -> None:
        """Close it with `answer`."""
        self.dismiss(answer)


class StatusScreen(App[None]):
    """State, faults with the next step, all figures."""

    TITLE = "micromanip"
    ENABLE_COMMAND_PALETTE = False
    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("a", "order('arm')", "arm"),
        Binding("h", "order('hold')", "hold"),
        Binding("d", "order('disarm')", "disarm"),
        Binding("r", "order('reset')", "reset"),
        Binding("q", "quit", "quit"),
    ]
    CSS = """
    #state { height: 3; content-align: center middle; text-style: bold; }
    #faults, #said { height: auto; padding: 0 1; }
    #faults { color: $text-error; text-style: bold; }
    #run { height: auto; padding: 0 1; }
    #values { padding: 0 1; height: 1fr; }
    """

    def __init__(self, socket_path: Path) -> None:
        super().__init__()
        self._path = socket_path
        self._ended = threading.Event()
        self._seen_s = time.monotonic()
        names = ("state", "faults", "said", "run", "table")
        self._part = {name: Static("", id=name, markup=False) for name in names}

    def compose(self) -> ComposeResult:
        with Vertical():
            for name in ("state", "faults", "said", "run"):
                yield self._part[name]
            with VerticalScroll(id="values"):
                yield self._part["table"]
        yield Footer(compact=True)

    def on_mount(self) -> None:
        """Begin to look."""
        for name in ("faults", "said", "run", "table"):
            self._set(name, "")
        self.run_worker(self._look, thread=True, name="look")

    def on_unmount(self) -> None:
        """Let the thread that looks come to its end."""
        self._ended.set()

    def _look(self) -> None:
        """Ask for the status, on a connection that is made anew where it was lost, until the screen is closed."""
        while not self._ended.is_set():
            try:
                with Client(self._path) as client:
                    while not self._ended.wait(LOOK_S):
                        self.call_later(self.show, client.status())
            except (MicromanipError, OSError) as problem:
                self.call_later(self.show_gone, problem)
                self._ended.wait(LOOK_S)

    def show(self, report: Status) -> None:
        """A new status."""
        self._seen_s = time.monotonic()
        self._show_state(report["state"], *_COLOURS.get(report["state"], _OTHER))
        self._set("faults", "\n".join(_fault_lines(report)))
        self._set("run", one_line(report).strip())
        self._set("table", details(report))

    def show_gone(self, problem: Exception) -> None:
        """There is no controller any more, or none that answers: nothing that was shown before is true now."""
        ago_s = time.monotonic() - self._seen_s
        gone = isinstance(problem, DeviceUnavailable)
        self._show_state("NO CONTROLLER" if gone else "NO ANSWER", *_COLOURS["FAULT"])
        self._set("faults", f"{problem}\nlast heard of {ago_s:.0f} s ago; trying again")
        self._set("run", "")
        self._set("table", "")

    def _show_state(self, state: str, text: str, background: str) -> None:
        bar = self._part["state"]
        bar.update(Text(" ".join(state)))
        bar.styles.color, bar.styles.background = text, background

    def _set(self, name: str, text: RenderableType) -> None:
        self._part[name].update(text)
        self._part[name].display = bool(text)

    def action_order(self, order: str) -> None:
        """Ask, and send it where the answer is yes."""

        def answered(yes: bool | None) -> None:
            if yes:
                self._set("said", f"{order} ...")
                self.run_worker(lambda: self._send(order), thread=True, name=order)

        self.push_screen(Question(_ORDERS[order][1]), answered)

    def _send(self, order: str) -> None:
        try:
            with Client(self._path) as client:
                _ORDERS[order][0](client)
            said = f"{order}: done"
        except (MicromanipError, OSError) as refusal:
            said = str(refusal)
        self.call_later(self._set, "said", said)


def _fault_lines(report: Status) -> list[str]:
    """What is latched, and below it the next step; and sensors that come too seldom."""
    lines = []
    for fault in report["fault_reports"]:
        lines.append(fault["seen"])
        if fault["next_step"]:
            lines.append(f"  next: {fault['next_step']}")
    return [*lines, *report["slow_signals"]]
