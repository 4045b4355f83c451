"""The layout of frames, beside python-can's own for SocketCAN."""

import can
from can.interfaces.socketcan.constants import CAN_EFF_FLAG, CAN_RTR_FLAG, CANFD_BRS, CANFD_FDF
from can.interfaces.socketcan.socketcan import build_can_frame, dissect_can_frame, is_frame_fd
from hypothesis import given
from hypothesis import strategies as st

from micromanip.bus.can_bits import FD_LENGTHS
from micromanip.testbus.frame import Frame, pack, unpack


@st.composite
def frames(draw):
    extended, fd = draw(st.booleans()), draw(st.booleans())
    remote = not fd and draw(st.booleans())
    length = 0 if remote else draw(st.sampled_from(FD_LENGTHS if fd else range(9)))
    return Frame(
        draw(st.integers(0, 0x1FFFFFFF if extended else 0x7FF)),
        draw(st.binary(min_size=length, max_size=length)),
        extended,
        fd,
        fd and draw(st.booleans()),
        remote,
    )


@given(frames())
def test_packed_as_python_can_does_for_socketcan(frame):
    message = can.Message(
        arbitration_id=frame.identifier,
        data=frame.data,
        is_extended_id=frame.extended,
        is_fd=frame.fd,
        bitrate_switch=frame.bitrate_switch,
        is_remote_frame=frame.remote,
    )
    assert unpack(build_can_frame(message)) == frame
    word, length, flags, data = dissect_can_frame(pack(frame))
    assert word == frame.identifier | frame.extended * CAN_EFF_FLAG | frame.remote * CAN_RTR_FLAG
    assert data[:length] == frame.data
    assert is_frame_fd(pack(frame)) is frame.fd
    assert flags == frame.fd * CANFD_FDF + frame.bitrate_switch * CANFD_BRS


def test_priority_is_that_of_the_wire():
    """A base identifier beats all extended ones that begin with it, a data frame the remote frame."""
    ascending = [
        Frame(0x000),
        Frame(0x0FF, extended=True),
        Frame(0x100),
        Frame(0x100, remote=True),
        Frame(0x100 << 18, extended=True),
        Frame(0x100 << 18, extended=True, remote=True),
        Frame((0x100 << 18) + 1, extended=True),
        Frame(0x101),
        Frame(0x7FF),
    ]
    assert sorted(ascending, key=lambda frame: frame.priority) == ascending
    assert len({frame.priority for frame in ascending}) == len(ascending)
