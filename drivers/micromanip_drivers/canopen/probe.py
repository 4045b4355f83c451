"""Which nodes are on the bus: each number is asked for what every CANopen device has to tell."""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping

import can
from canopen.sdo.exceptions import SdoAbortedError

from micromanip.driver import Answer, TransientError

from ..canbus.link import CanLink, LinkOptions
from .dictionary import number

_UPLOAD = 0x40
_EXPEDITED = 0x43
_ABORTED = 0x80
_REQUEST, _ANSWER = 0x600, 0x580
_ASKED = {"device_type": (0x1000, 0), "vendor_id": (0x1018, 1), "product_code": (0x1018, 2)}
_PAUSE_NS = 1_000_000


def probe(options: LinkOptions, configured: Mapping[int, str], seconds: float) -> Iterator[Answer]:
    """Ask all 127 node numbers, one after the other; nothing is written. Raises LinkError.

    `configured` are the names of the nodes that the configuration has.
    """
    link = CanLink(options)
    link.open_fully()
    try:
        end_ns = time.monotonic_ns() + round(seconds * 1e9)
        found: dict[int, dict[str, int]] = {}
        refusals: dict[int, list[str]] = {}
        for name, (index, subindex) in _ASKED.items():
            numbers = list(range(1, 128)) if name == "device_type" else sorted(found)
            for node_id in numbers:
                _ask(link, node_id, index, subindex)
                _listen(link, min(end_ns, time.monotonic_ns() + _PAUSE_NS), found, refusals)
            _listen(link, min(end_ns, time.monotonic_ns() + 100 * _PAUSE_NS), found, refusals)
        for node_id, values in sorted(found.items()):
            note = (
                f"{configured[node_id]} in the configuration" if node_id in configured else "not in the configuration"
            )
            note = "; ".join([note, *refusals.get(node_id, [])])
            yield Answer(f"node {node_id}", values, note, is_value=bool(values))
        for node_id, name in sorted(configured.items()):
            if node_id not in found:
                yield Answer(f"node {node_id}", {}, f"{name} in the configuration, no answer", is_value=False)
    finally:
        link.close()


def _ask(link: CanLink, node_id: int, index: int, subindex: int) -> None:
    data = bytes((_UPLOAD, *index.to_bytes(2, "little"), subindex, 0, 0, 0, 0))
    message = can.Message(arbitration_id=_REQUEST + node_id, data=data, is_extended_id=False)
    try:
        link.send(message)
    except TransientError:
        time.sleep(0.01)  # a full buffer
        link.send(message)


def _listen(link: CanLink, until_ns: int, found: dict[int, dict[str, int]], refusals: dict[int, list[str]]) -> None:
    """Until then, what comes: values into `found`, by node and name; a node that refuses one is there as well."""
    while True:
        for message, _ in link.receive(until_ns):
            data = bytes(message.data)
            if message.is_extended_id or len(data) != 8 or data[0] not in (_EXPEDITED, _ABORTED):
                continue
            node_id = message.arbitration_id - _ANSWER
            for name, (index, subindex) in _ASKED.items():
                if not (1 <= node_id <= 127 and data[1:4] == bytes((*index.to_bytes(2, "little"), subindex))):
                    continue
                said, values = int.from_bytes(data[4:], "little"), found.setdefault(node_id, {})
                if data[0] == _EXPEDITED:
                    values[name] = said
                else:
                    told = f"refuses to read {number(index, subindex)} ({SdoAbortedError(said)})"
                    refusals.setdefault(node_id, []).append(told)
        if time.monotonic_ns() >= until_ns:
            return
