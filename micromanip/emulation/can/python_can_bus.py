"""A bus of python-can where the hub of the test bus would be: devices played on vcan, or with a second adapter."""

from __future__ import annotations

from typing import Any

import can

from micromanip.bus.can_bits import worst_case_s
from micromanip.errors import DeviceUnavailable
from micromanip.testbus.event_loop import EventLoop
from micromanip.testbus.frame import Frame
from micromanip.testbus.port import Node
from micromanip.testbus.wire import Statistics


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
