"""A wire that the loop itself serves: the driver of one (``LoopWire``), frames as tables, a socket; no compiler.

``micromanip.driver.datagrams`` has the compiled functions that walk them.
"""

from micromanip.bus.datagram_socket import hand_over, lend, open_datagrams
from micromanip.bus.frame_plan import DeviceCounter, FramePlan, GroupPlan, fill_number
from micromanip.bus.loop_wire import LoopOutput, LoopWire, LoopWireOptions
from micromanip.bus.number_options import NumberCodec
from micromanip.bus.watchdog import Milliseconds, Watchdog
from micromanip.rt.bus_image import FOLLOWING, RESTING
from micromanip.rt.io.clock_lock import CLOCK_LOCK, DEVICE_CLOCK, MOST_BITS, forget_clock, set_lock, taken_ns
from micromanip.rt.io.context import BATCH, SOCKET, WIRE
from micromanip.rt.io.counting import COUNTED
from micromanip.rt.io.frames import (
    FRAME,
    GOOD,
    MAX_BYTES,
    NUMBER,
    SAMPLES,
    begin_frame,
    judged,
    put_value,
    seal,
    status_of,
    value_of,
)
from micromanip.rt.io.link_gate import ANSWERS, RECENT
from micromanip.rt.io.numbers import CODE, FLOATING, SIGNED, UNSIGNED
from micromanip.rt.record import move, record
