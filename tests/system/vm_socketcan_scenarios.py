"""The driver `canbus` on a kernel's SocketCAN, with can-utils and cantools as witnesses: run by the campaign ``vm``."""

import random
import subprocess
import time

import pytest
from micromanip_drivers.canbus.link import CanLink, LinkOptions

from micromanip.bus.inbox import Inbox

from .can_driver import CLASSIC, FD, LINK, PATIENCE_NS, driver, message_of, seen_empty, sensors, taken
from .machine import ok
from .vcan import CHANNEL, Dump, written

pytestmark = pytest.mark.usefixtures("nobody")


def wall_clock_ahead_ns():
    """By how much it is ahead of CLOCK_MONOTONIC, at most: the least of some readings."""
    return min(-time.monotonic_ns() + time.time_ns() for _ in range(100))


@pytest.mark.parametrize("kind", [FD, CLASSIC], ids=["fd", "classic"])
def test_candump_shows_what_cantools_encodes(opened, kind):
    bus = opened(driver(received="Tracker", **kind))
    message = message_of(kind["database"], "Voltages")
    names = [channel.name.removeprefix("Voltages.") for channel in bus.outputs]
    draw = random.Random(1)
    commands = [dict.fromkeys(names, 0), dict.fromkeys(names, 1)]
    for _ in range(20):
        voltages = {name: draw.choice([-20.0, 150.0, draw.uniform(-20.0, 150.0)]) for name in names[:3]}
        commands.append(voltages | {name: draw.randint(0, 1) for name in names[3:]})
    assert names[:3] == ["voltage_x", "voltage_y", "voltage_z"]
    with Dump(len(commands)) as dump:
        for command in commands:
            bus.perform(0, [float(command[name]) for name in names], Inbox())
        seen = dump.frames()
    flags = "#1" if message.is_fd else ""  # the data at the higher rate
    assert seen == [
        f"100#{flags}{message.encode(command | {'Count': count}).hex().upper()}"
        for count, command in enumerate(commands)
    ]


def test_frames_of_cansend_are_taken_apart_as_cantools_does(opened):
    bus = opened(driver(**FD))
    names = [channel.name.removeprefix("Sensors.") for channel in bus.inputs]
    for count, strain_um in enumerate((-838.8608, -0.0001, 0.0, 65.4321, 838.8607)):
        frame, values = sensors(count, strain_x=strain_um, stage_z=-strain_um / 2, Status=2, interlock=1)
        ok("cansend", CHANNEL, frame)
        assert {names[sample.channel]: sample.value for sample in taken(bus)} == pytest.approx(
            {name: values[name] for name in names}, rel=1e-12
        )
    assert bus.statistics()["frames_in"] == 5
    assert bus.statistics()["lost"] == 0


def test_whatever_cangen_sends_is_received_as_candump_sees_it(opened):
    link = opened(CanLink(LinkOptions(**LINK, data_bitrate=5_000_000)))
    count, frames = 300, []
    start_ns = time.monotonic_ns()
    with Dump(count) as dump, subprocess.Popen(["cangen", CHANNEL, "-m", "-g", "2", "-n", str(count)]) as generator:
        while len(frames) < count and time.monotonic_ns() < start_ns + PATIENCE_NS:
            frames += link.receive(time.monotonic_ns() + 1_000_000_000)
        end_ns = time.monotonic_ns()
        assert generator.wait() == 0
        assert [written(message) for message, _ in frames] == dump.frames()
    assert {(m.is_fd, m.is_extended_id, m.is_remote_frame) for m, _ in frames} >= {
        *((True, extended, False) for extended in (True, False)),
        *((False, extended, remote) for extended in (True, False) for remote in (True, False)),
    }
    times_ns = [time_ns for _, time_ns in frames]
    assert times_ns == sorted(times_ns)
    assert start_ns <= times_ns[0]
    assert times_ns[-1] <= end_ns
    assert len(set(times_ns)) > count / 2  # each frame has its own, not that of the call that took many


def test_time_is_that_of_the_kernel(opened):
    """What candump shows of the same frames, though they are read long after they came."""
    bus = opened(driver(**FD))
    empty_ns, ahead_ns, count = seen_empty(bus), wall_clock_ahead_ns(), 5
    with Dump(count) as dump:
        for number in range(count):
            ok("cansend", CHANNEL, sensors(number)[0])
        theirs_ns = [stamp_ns - ahead_ns for stamp_ns, _ in dump.lines()]
    time.sleep(2.0)
    ours_ns = sorted({sample.time_ns for sample in taken(bus)})
    assert len(ours_ns) == count
    assert empty_ns <= ours_ns[0]
    older_ns = [theirs - ours for theirs, ours in zip(theirs_ns, ours_ns, strict=True)]
    assert min(older_ns) > -1_000_000  # never newer, but for what the clocks' readings are apart
    assert min(older_ns) < 500_000_000  # a stall between two readings makes one older, not all of them
