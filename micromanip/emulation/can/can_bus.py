"""The bus that CAN devices are emulated on: the test bus, or an interface of python-can (vcan, a second adapter)."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import can

from micromanip.bus.can_bits import worst_case_s
from micromanip.errors import DeviceUnavailable, UsageError
from micromanip.testbus.event_loop import EventLoop
from micromanip.testbus.faults import parsed
from micromanip.testbus.frame import Frame
from micromanip.testbus.hub import CanHub
from micromanip.testbus.port import Node
from micromanip.testbus.wire import Statistics

_TEST_BUS = "micromanip"


class CanBus:
    """The test bus, or an interface of python-can; what is the same whatever is spoken on it."""

    def __init__(self, keys: Any, loop: EventLoop) -> None:
        """The bus that a driver's options name. Raises DeviceUnavailable where it is in use, or can't be reached."""
        s = self._keys = keys
        self.line: CanHub | PythonCanBus
        if s.interface == _TEST_BUS:
            self.line = CanHub(loop, str(s.channel), s.bitrate, s.data_bitrate)
        else:
            self.line = PythonCanBus(loop, s.interface, str(s.channel), s.bitrate, s.data_bitrate)
        self._loop = loop
        self._began_ns = loop.now_ns()

    def described(self, out: int, into: int) -> str:
        """With so many messages out of the devices, and into them."""
        s = self._keys
        kbits = "/".join(f"{rate / 1e3:g}" for rate in (s.bitrate, s.data_bitrate) if rate)
        return f"{s.channel}: {out} message{'s' * (out != 1)} out, {into} in, {kbits} kbit/s"

    def start(self, now_ns: int) -> None:
        """Count the load from now on."""
        self._began_ns = now_ns

    def inject(self, fault: Mapping[str, Any]) -> None:
        """Disturb the bus. Raises UsageError for what is no such fault, or where it isn't the test bus."""
        if not isinstance(self.line, CanHub):
            name = f"{self._keys.interface} {self._keys.channel}"
            raise UsageError(f"{name} can't be disturbed; the test bus, interface {_TEST_BUS}, can")
        self.line.faults.inject(parsed(dict(fault)))

    def clear(self) -> None:
        """End what was injected."""
        if isinstance(self.line, CanHub):
            self.line.faults.clear()

    def report(self) -> dict[str, Any]:
        """Frames and load since the start."""
        bus = self.line.statistics
        elapsed_ns = max(1, self._loop.now_ns() - self._began_ns)
        return {
            "frames": bus.frames,
            "destroyed": bus.destroyed,
            "bus_load_percent": round(100 * bus.busy_ns / elapsed_ns, 2),
        }

    def close(self) -> None:
        """Let go of the bus."""
        self.line.close()


class PythonCanBus:
    """Attach nodes as to a hub. They don't hear one another; time stamps are those of the reading."""

    def __init__(
        self, loop: EventLoop, interface: str, channel: str, bitrate: int, data_bitrate: int | None = None
    ) -> None:
        """Raises DeviceUnavailable where the interface can't be opened, or not be waited for."""
        self.statistics = Statistics()
        self._loop, self._bitrate, self._data_bitrate = loop, bitrate, data_bitrate
        self._name = f"{interface} {channel}"
        self._nodes: list[Node] = []
        rates: dict[str, Any] = {"bitrate": bitrate} | (
            {"fd": True, "data_bitrate": data_bitrate} if data_bitrate else {}
        )
        try:
            self._bus: Any = can.Bus(interface=interface, channel=channel, **rates)
        except (can.CanError, OSError, ImportError, ValueError) as problem:
            raise DeviceUnavailable(f"{self._name} can't be opened: {problem}") from problem
        try:
            self._fileno = int(self._bus.fileno())
        except (NotImplementedError, can.CanError) as problem:
            self._bus.shutdown()
            raise DeviceUnavailable(f"{self._name} can't be waited for; play devices on socketcan") from problem
        loop.add_reader(self._fileno, self._read)

    def now_ns(self) -> int:
        """The loop's time."""
        return self._loop.now_ns()

    def attach(self, node: Node) -> None:
        """Let a node take part."""
        self._nodes.append(node)

    def detach(self, node: Node) -> None:
        """Take a node off the bus."""
        self._nodes.remove(node)

    def send(self, node: Node, frame: Frame, time_ns: int | None = None) -> bool:  # noqa: ARG002
        """Send a frame at once; False if the interface does not take it."""
        message = can.Message(
            arbitration_id=frame.identifier,
            data=frame.data,
            is_extended_id=frame.extended,
            is_fd=frame.fd,
            bitrate_switch=frame.bitrate_switch,
        )
        try:
            self._bus.send(message)
        except can.CanError:
            return False
        self._count(frame)
        return True

    def close(self) -> None:
        """Let go of the interface."""
        self._loop.remove_reader(self._fileno)
        self._bus.shutdown()

    def _read(self) -> None:
        try:
            message = self._bus.recv(0)
        except can.CanError as problem:
            raise DeviceUnavailable(f"{self._name} is gone: {problem}") from problem
        if message is None or message.is_error_frame:
            return
        frame = Frame(
            message.arbitration_id,
            bytes(message.data),
            message.is_extended_id,
            message.is_fd,
            message.bitrate_switch,
            message.is_remote_frame,
        )
        self._count(frame)
        now_ns = self.now_ns()
        for node in list(self._nodes):
            node.on_frame(frame, now_ns)

    def _count(self, frame: Frame) -> None:
        data_bitrate = (self._data_bitrate if frame.bitrate_switch else self._bitrate) if frame.fd else None
        length = 0 if frame.remote else len(frame.data)
        self.statistics.frames += 1
        self.statistics.busy_ns += round(worst_case_s(length, self._bitrate, data_bitrate, frame.extended) * 1e9)
