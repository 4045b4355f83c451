"""Reading and writing a node's objects while it is opened, through our own receive loop.

The protocol is that of the `canopen` library's client. What the library leaves to a thread of its own, taking answers
off the bus, is done here, by the caller and until a deadline. Nothing of this runs while the loop is controlled.
"""

from __future__ import annotations

import time
from collections.abc import Callable

import can
from canopen.sdo.client import SdoClient
from canopen.sdo.exceptions import SdoAbortedError, SdoCommunicationError

from micromanip.driver import IdentityMismatch, LinkError

from ..canbus.link import CanLink
from .dictionary import number
from .plan import NodePlan

_REQUEST, _RESPONSE = 0x600, 0x580
_ABORTED = 0x80
_INITIATES = (1, 2)
"""Command specifiers whose answers name the object."""
_NOT_NOW = (0x08000020, 0x08000021, 0x08000022)
"""Abort codes of a device that can't at present."""
_TIMEOUT_NS = 100_000_000


class Sdo(SdoClient):
    """Access to the objects of one node, until `deadline_ns`. `other` is given what else came meanwhile."""

    MAX_RETRIES = 3  # tries: a question may be lost, and asking or writing the same again changes nothing

    def __init__(
        self, link: CanLink, plan: NodePlan, deadline_ns: int, other: Callable[[can.Message, int], None]
    ) -> None:
        node_id = plan.options.node_id
        super().__init__(_REQUEST + node_id, _RESPONSE + node_id, plan.dictionary.objects)  # type: ignore[no-untyped-call]
        self._link, self._plan, self._deadline_ns, self._other = link, plan, deadline_ns, other
        self._asked = b""

    @property
    def _who(self) -> str:
        return f"node {self._plan.name} (number {self._plan.options.node_id})"

    def read(self, index: int, subindex: int = 0) -> int:
        """An integer object. Raises LinkError without an answer, IdentityMismatch if the node has no such object."""
        what = f"read {number(index, subindex)}"
        try:
            return int.from_bytes(self.upload(index, subindex), "little")
        except SdoAbortedError as problem:
            raise self._aborted(what, problem) from problem
        except SdoCommunicationError as problem:
            raise LinkError(f"{self._who} does not answer when asked to {what}") from problem

    def read_if_told(self, index: int, subindex: int) -> int | None:
        """The same, None where the node refuses. Raises LinkError without an answer."""
        try:
            return self.read(index, subindex)
        except IdentityMismatch:
            return None

    def write(self, index: int, subindex: int, value: int) -> None:
        """Set an integer object. Raises as ``read`` does."""
        what = f"set {number(index, subindex)} to 0x{value:X}"
        try:
            self.download(index, subindex, self._plan.dictionary.variable(index, subindex).encode_raw(value))
        except SdoAbortedError as problem:
            raise self._aborted(what, problem) from problem
        except SdoCommunicationError as problem:
            raise LinkError(f"{self._who} does not answer when asked to {what}") from problem

    def answers(self) -> bool:
        """True if it answers to being asked for its device type, which every node has."""
        try:
            self.upload(0x1000, 0)
        except SdoCommunicationError:
            return False
        except SdoAbortedError:
            return True
        return True

    def send_request(self, request: bytearray) -> None:
        self._asked = bytes(request)
        self._link.send(can.Message(arbitration_id=self.rx_cobid, data=request, is_extended_id=False))

    def read_response(self) -> bytes:
        until_ns = min(time.monotonic_ns() + _TIMEOUT_NS, self._deadline_ns)
        while time.monotonic_ns() < until_ns:
            found = None
            for message, time_ns in self._link.receive(until_ns):
                if message.arbitration_id == self.tx_cobid and not message.is_extended_id:
                    data = bytes(message.data)
                    if self._is_answer(data):
                        found = data
                else:
                    self._other(message, time_ns)
            if found is not None:
                if found[0] == _ABORTED:
                    raise SdoAbortedError(int.from_bytes(found[4:8], "little"))
                return found
        raise SdoCommunicationError("no answer in time")

    def _is_answer(self, data: bytes) -> bool:
        """False for what belongs to an earlier question, or is no answer at all."""
        if len(data) != 8:
            return False
        return self._asked[0] >> 5 not in _INITIATES or data[1:4] == self._asked[1:4]

    def _aborted(self, what: str, problem: SdoAbortedError) -> LinkError | IdentityMismatch:
        told = f"{self._who} refuses to {what} ({problem})"
        if problem.code in _NOT_NOW:
            return LinkError(told)
        return IdentityMismatch(f"{told}: is {self._plan.dictionary.file.name} its EDS file?")
