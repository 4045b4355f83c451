"""A wire that the loop itself serves: descriptions of frames as tables, and a socket for compiled code; no compiler.

``micromanip.driver.datagrams`` has the compiled functions that walk them.
"""

from micromanip.bus.datagram_socket import hand_over, open_datagrams
from micromanip.bus.frame_plan import FramePlan, GroupPlan
from micromanip.rt.bus_image import DOWN, FOLLOWING, OUTPUT_NAMES, RESTING, TAKEN, UNKNOWN
from micromanip.rt.record import record
from micromanip.rt.wire.codec import begin_frame, put_value, seal
from micromanip.rt.wire.counting import COUNTED
from micromanip.rt.wire.device_clock import MOST_BITS
from micromanip.rt.wire.records import DEVICE_CLOCK, FRAME, MAX_GROUPS, SOCKET

OUTPUTS_REST, OUTPUTS_FOLLOW, OUTPUTS_UNKNOWN = (OUTPUT_NAMES[each] for each in (RESTING, FOLLOWING, UNKNOWN))
"""What a driver says of its outputs (``Wire``)."""

__all__ = [
    "COUNTED",
    "DEVICE_CLOCK",
    "DOWN",
    "FRAME",
    "MAX_GROUPS",
    "MOST_BITS",
    "OUTPUTS_FOLLOW",
    "OUTPUTS_REST",
    "OUTPUTS_UNKNOWN",
    "SOCKET",
    "TAKEN",
    "FramePlan",
    "GroupPlan",
    "begin_frame",
    "hand_over",
    "open_datagrams",
    "put_value",
    "record",
    "seal",
]
