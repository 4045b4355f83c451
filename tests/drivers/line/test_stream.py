"""The framing `stream`: packets cut and joined, samples at their own times, other devices, datagrams of all kinds."""

import contextlib
import time

import pytest
from micromanip_drivers.line.framing import LineTime, Silence
from micromanip_drivers.line.options import TcpPort
from micromanip_drivers.line.stream import StreamFraming
from micromanip_drivers.line.stream_options import Stream

from micromanip.bus.errors import IdentityMismatch, TransientError
from micromanip.bus.inbox import Inbox

from .scripted_port import ScriptedPort
from .sensors import SENSOR, TRACKER, CapacitiveSensor, LaserTracker
from .wires import TcpWire, UdpWire

PERIOD_NS = 500_000
SAMPLER, TRACER = CapacitiveSensor(TcpWire()), LaserTracker(UdpWire())


def framing(options=SENSOR, datagrams=False, silence_ms=500.0, **changed):
    port = ScriptedPort(lambda data: [], datagrams)
    one = StreamFraming(
        Stream.model_validate({**options["stream"], **changed}),
        port,
        LineTime(TcpPort(host="device", port=1)),
        Silence(port.name, silence_ms),
    )
    return one, port


def begun(first, **changed):
    one, port = framing(**changed)
    port.coming.append((time.monotonic_ns(), first))
    one.begin(time.monotonic_ns() + 200_000_000)
    return one, port


def taken(one, port, *wires, at_ns=None, channel=0):
    inbox = Inbox()
    port.coming += [(at_ns or time.monotonic_ns(), wire) for wire in wires]
    with contextlib.suppress(TransientError):
        one.receive(inbox, time.monotonic_ns())
    return [sample for sample in inbox if sample.channel == channel]


def packet(count, *xs):
    return SAMPLER.packet(count, *[(x, 2 * x, -x) for x in xs])


def test_samples_of_a_packet_have_their_own_times():
    one, port = begun(packet(0, 1))
    at_ns = time.monotonic_ns()
    samples = taken(one, port, packet(1, 10, 20, 30, 40), at_ns=at_ns)
    assert [sample.value for sample in samples] == pytest.approx([1e-4, 2e-4, 3e-4, 4e-4])
    latency_ns = round(one.inputs[0].latency_s * 1e9)
    assert [at_ns - latency_ns - sample.time_ns for sample in samples] == [3 * PERIOD_NS, 2 * PERIOD_NS, PERIOD_NS, 0]


def test_packet_of_another_device_is_no_sample():
    """Somebody plugged another sensor to the same converter; or noise that looks like a packet."""
    one, port = begun(packet(0, 5))
    other = CapacitiveSensor(TcpWire())
    other.serial_number = 1
    port.coming.append((time.monotonic_ns(), other.packet(1, (9, 9, 9))))
    inbox = Inbox()
    with pytest.raises(TransientError, match="of another device"):
        one.receive(inbox, time.monotonic_ns())
    assert not len(inbox)
    with pytest.raises(IdentityMismatch, match="serial_number 1, the configuration says 4711"):
        begun(other.packet(1, (9, 9, 9)) * 2)


def test_number_that_is_none_is_marked():
    one, port = begun(TRACER.datagram(0, 0, 0.0, 0.0, 0.0), options=TRACKER, datagrams=True)
    samples = taken(one, port, TRACER.datagram(1, 1000, float("nan"), 1.0, float("inf")))
    assert [sample.status for sample in samples] == [-1]
    assert [sample.status for sample in taken(one, port, TRACER.datagram(2, 2000, 0.0, 1.0, 1.0))] == [0]


def test_time_stamps_of_the_tracker():
    """Datagrams that come late, one behind the other, have the times at which they were measured."""
    born_ns = time.monotonic_ns() - 20_000_000
    one, port = begun(TRACER.datagram(0, 0, 0.0, 0.0, 0.0), options=TRACKER, datagrams=True, latency_us=0.0)
    began_ns = taken(one, port, TRACER.datagram(1, 1000, 0.0, 0.0, 0.0), at_ns=born_ns + 1_000_000)[0].time_ns
    late_ns = born_ns + 9_000_000
    samples = taken(one, port, *[TRACER.datagram(n, 1000 * n, 0.0, 0.0, 0.0) for n in range(2, 8)], at_ns=late_ns)
    assert [sample.time_ns - began_ns for sample in samples] == pytest.approx(
        [1_000_000 * n for n in range(1, 7)], abs=5_000
    )


def test_datagrams_doubled_lost_and_out_of_order():
    one, port = begun(TRACER.datagram(0, 0, 0.0, 0.0, 0.0), options=TRACKER, datagrams=True)
    wires = [TRACER.datagram(n, 1000 * n, float(n), 0.0, 0.0) for n in range(8)]
    samples = taken(one, port, wires[1], wires[1], wires[3], wires[2], wires[6], wires[7][:-1], wires[7])
    assert [(round(sample.value / 1000), sample.lost) for sample in samples] == [(1, 0), (3, 1), (6, 2), (7, 0)]
    assert one.counters["not_fresh"] == 2
