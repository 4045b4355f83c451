"""Compiled functions for a cyclic driver on a wire: send and receive without Python, frames to values and back."""

from micromanip.rt.io.clock_lock import forget_clock, hear_clock, steer, taken_ns
from micromanip.rt.io.context import BATCH
from micromanip.rt.io.counting import OLD, RESTARTED, missing_before
from micromanip.rt.io.frames import (
    GOOD,
    WRONG_CHECKSUM,
    WRONG_LENGTH,
    begin_frame,
    bits_at,
    code_of,
    judged,
    leave_samples,
    put_value,
    seal,
    status_of,
    value_of,
)
from micromanip.rt.io.link_gate import acknowledge, has_sent, on_link_lost, turn
from micromanip.rt.io.link_loop import NOT_OPEN, begin, end, give, rest, send_due, take, wait_for_answer
from micromanip.rt.io.numbers import find_code, value_of_code
from micromanip.rt.io.sockets import close, is_from_peer, length_of, receive, received_ns, send
