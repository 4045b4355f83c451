"""Process data of a CANopen test node: TPDOs at SYNC or by event timer, RPDOs and the watch over them."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping

from micromanip.emulation.amplifier import Watchdog
from micromanip.testbus.event_loop import EventLoop, Timer
from micromanip.testbus.frame import Frame

from .canopen_objects import Entry, Objects, Pdo, packed, unpacked

_ERROR_MODE, _ERROR_VALUE = 0x6443, 0x6444
_MS = 1_000_000


class TooShort(Exception):  # noqa: N818
    """An RPDO had fewer bytes than its mapping."""


class Exchange:
    """The PDOs of one node, while it is OPERATIONAL; outputs that were received live on after that."""

    def __init__(
        self,
        loop: EventLoop,
        objects: Objects,
        measure: Callable[[Iterable[str]], Iterable[float]],
        write: Callable[[Mapping[str, float]], None],
        send: Callable[[Frame], object],
        left_alone: Callable[[], None],
    ) -> None:
        """`left_alone` is called when no RPDO came for as long as its event timer says."""
        self._loop, self._objects, self._send, self._left_alone = loop, objects, send, left_alone
        self._measure, self._write = measure, write
        self._tpdos: tuple[Pdo, ...] = ()
        self._rpdos: dict[int, Pdo] = {}
        self._running = False
        self._syncs = 0
        self._pending: dict[int, bytes] = {}
        self._watches: dict[int, Watchdog] = {}
        self._events: list[Timer] = []
        self.set_up()

    def set_up(self) -> None:
        """Take the PDOs over as the objects have them now."""
        self._tpdos = tuple(self._objects.tpdos())
        self._rpdos = {pdo.identifier: pdo for pdo in self._objects.rpdos()}

    def start(self) -> None:
        """The node became OPERATIONAL."""
        self._running, self._syncs = True, 0
        for pdo in self._tpdos:
            if pdo.transmission >= 254:
                self._by_event(pdo, self._loop.now_ns())

    def stop(self) -> None:
        """The node is OPERATIONAL no longer; its outputs stay, and so does the watch over them."""
        self._running = False
        self._pending.clear()
        for timer in self._events:
            timer.cancel()
        self._events.clear()

    def make_safe(self) -> None:
        """Bring the outputs to their error values, and watch them no more."""
        for watch in self._watches.values():
            watch.stop()
        for pdo in self._rpdos.values():
            self._take(pdo, sum(packed(entry, self._error_value(entry)) for entry in pdo.entries))

    def on_sync(self) -> None:
        """A SYNC came."""
        if not self._running:
            return
        self._syncs += 1
        for identifier, data in self._pending.items():
            self._take(self._rpdos[identifier], int.from_bytes(data, "little"))
        self._pending.clear()
        for pdo in self._tpdos:
            if 1 <= pdo.transmission <= 240 and self._syncs % pdo.transmission == 0:
                self._transmit(pdo)

    def on_frame(self, identifier: int, data: bytes, time_ns: int) -> None:
        """A frame that may be an RPDO. Raises TooShort."""
        pdo = self._rpdos.get(identifier)
        if pdo is None or not self._running:
            return
        if len(data) < pdo.length:
            raise TooShort
        if pdo.event_ms:
            watch = self._watches.setdefault(identifier, Watchdog(self._loop, self._left_alone))
            watch.feed(time_ns, pdo.event_ms * _MS)
        if pdo.transmission <= 240:
            self._pending[identifier] = data
        else:
            self._take(pdo, int.from_bytes(data, "little"))

    def _transmit(self, pdo: Pdo) -> None:
        frame = sum(map(packed, pdo.entries, self._measure([entry.variable.name for entry in pdo.entries])))
        self._send(Frame(pdo.identifier, frame.to_bytes(pdo.length, "little")))

    def _by_event(self, pdo: Pdo, due_ns: int) -> None:
        self._transmit(pdo)
        self._events = [timer for timer in self._events if timer.time_ns > due_ns]
        if pdo.event_ms:
            next_ns = due_ns + pdo.event_ms * _MS
            self._events.append(self._loop.call_at(next_ns, lambda: self._by_event(pdo, next_ns)))

    def _take(self, pdo: Pdo, frame: int) -> None:
        """The outputs of a PDO get other values, which their objects have from now on."""
        for entry in pdo.entries:
            self._objects.put_raw(entry, frame)
        self._write({entry.variable.name: unpacked(entry, frame) for entry in pdo.entries})

    def _error_value(self, entry: Entry) -> float:
        objects, subindex = self._objects, entry.variable.subindex
        if not objects.has(_ERROR_VALUE, subindex) or not objects.raw(_ERROR_MODE, subindex):
            return 0.0
        return float(objects.raw(_ERROR_VALUE, subindex) * entry.variable.factor)
