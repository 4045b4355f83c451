"""A wire that the loop itself serves: the driver of one (``LoopWire``), frames as tables, a socket; no compiler.

``micromanip.driver.datagrams`` has the compiled functions that walk them.
"""

from micromanip.bus.datagram_socket import hand_over, lend, open_datagrams
from micromanip.bus.device_counter import DeviceCounter
from micromanip.bus.frame_plan import FramePlan, GroupPlan, fill_number
from micromanip.bus.loop_wire import LoopWire
from micromanip.bus.loop_wire_options import LoopOutput, LoopWireOptions
from micromanip.bus.number_codec import NumberCodec
from micromanip.bus.output_gate import adopt_limits, close_gate, gate_statistics, wait_for_rest, wire_of
from micromanip.bus.watchdog import Milliseconds, Watchdog
from micromanip.rt.bus_image import DOWN, TAKEN
from micromanip.rt.io.clock_lock import CLOCK_LOCK, set_lock
from micromanip.rt.io.codec import begin_frame, put_value, seal
from micromanip.rt.io.context import WIRE
from micromanip.rt.io.counting import COUNTED
from micromanip.rt.io.device_clock import MOST_BITS
from micromanip.rt.io.frames import (
    BATCH,
    CODE,
    DEVICE_CLOCK,
    FLOATING,
    FRAME,
    MAX_BYTES,
    NUMBER,
    SIGNED,
    SOCKET,
    UNSIGNED,
)
from micromanip.rt.io.link_gate import ANSWERS, FOLLOWING, LINK_GATE, QUIET, RECENT, RESTING
from micromanip.rt.io.samples import SAMPLES
from micromanip.rt.record import move, record
from micromanip.rt.records import MAX_OUTPUTS
