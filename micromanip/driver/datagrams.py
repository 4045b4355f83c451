"""Compiled functions for a cyclic driver on a wire: send and receive without Python, frames to values and back."""

from micromanip.rt.wire.clock_lock import hear_clock, steer
from micromanip.rt.wire.codec import (
    BAD_STATUS,
    GOOD,
    NOT_THIS_FRAME,
    WRONG_CHECKSUM,
    WRONG_LENGTH,
    begin_frame,
    bits_at,
    code_of,
    judged,
    put_value,
    seal,
    status_of,
    value_of,
)
from micromanip.rt.wire.counting import OLD, RESTARTED, missing_before
from micromanip.rt.wire.datagrams import close, is_from_peer, length_of, receive, received_ns, send
from micromanip.rt.wire.device_clock import forget_clock, taken_ns
from micromanip.rt.wire.gate import acknowledge, has_rest, has_sent, lose, put_back, turn
from micromanip.rt.wire.giving import give
from micromanip.rt.wire.numbers import find_code, value_of_code
from micromanip.rt.wire.records import BATCH
from micromanip.rt.wire.samples import leave_samples
from micromanip.rt.wire.serving import NOT_OPEN, begin, end, rest, send_due, send_outputs, take, wait_for_answer
