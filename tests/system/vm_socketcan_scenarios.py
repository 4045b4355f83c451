"""The driver `canbus` on a kernel's SocketCAN, with can-utils and cantools as witnesses: run by ``make test-vm``."""

import random
import subprocess
import time
from pathlib import Path

import cantools
import pytest
from micromanip_drivers.canbus.driver import CanBus
from micromanip_drivers.canbus.link import CanLink, LinkOptions

from micromanip.io.bus import Inbox
from micromanip.io.bus_errors import DeviceFault, LinkError, TransientError

from .machine import ok
from .vcan import CHANNEL, Dump, set_link, written
from .vm_cell import DATABASES

LINK = {"interface": "socketcan", "channel": CHANNEL, "bitrate": 1_000_000}
FD = {"database": "manipulator.dbc", "data_bitrate": 5_000_000}
CLASSIC = {"database": "classic.dbc"}
PATIENCE_NS = 60_000_000_000
RECEIVE_BUFFER = Path("/proc/sys/net/core/rmem_default")


def driver(database, received="Sensors", **options):
    """One that sends Voltages and receives `received`."""
    keys = LINK | {"silence_ms": None} | options
    messages = {
        "receive": {received: {"rate_hz": 100, "counter": "Count", "latency_us": 0}},
        "send": {"Voltages": {"rate_hz": 100, "counter": "Count"}},
    }
    return CanBus(CanBus.Options.model_validate(keys | messages | {"database": database}), DATABASES)


@pytest.fixture
def opened():
    """Drivers and links that are closed at the end, and vcan0 as it was."""
    buses = []

    def open_one(bus):
        buses.append(bus)
        bus.open()
        return bus

    yield open_one
    for bus in buses:
        bus.close()
    set_link("up")


@pytest.fixture
def step_wall_clock():
    """Sets the wall clock forward or back, as ``date --set`` does; it is right again at the end."""
    ahead_s = time.clock_gettime(time.CLOCK_REALTIME) - time.clock_gettime(time.CLOCK_MONOTONIC)

    def step(seconds):
        ok("date", "--set", f"@{time.time() + seconds:.6f}")

    yield step
    ok("date", "--set", f"@{ahead_s + time.clock_gettime(time.CLOCK_MONOTONIC):.6f}")


def taken(bus):
    """The next samples: value and time by channel number, as soon as there are any."""
    inbox = Inbox()
    end_ns = time.monotonic_ns() + PATIENCE_NS
    while not len(inbox) and time.monotonic_ns() < end_ns:
        bus.receive(inbox, end_ns)
    return list(inbox)


def seen_empty(bus):
    """A moment from which on nothing is left that came before it."""
    inbox = Inbox()
    while True:
        moment = time.monotonic_ns()
        inbox.clear()
        bus.receive(inbox, moment)
        if not len(inbox):
            return moment


def sensors(count, **values):
    """The message Sensors as `cansend` takes it, and the values that it carries, by cantools."""
    message = cantools.database.load_file(DATABASES / "manipulator.dbc").get_message_by_name("Sensors")
    data = message.encode({signal.name: 0 for signal in message.signals} | {"Count": count} | values)
    return f"101##1{data.hex()}", message.decode(data, decode_choices=False)


@pytest.mark.parametrize("kind", [FD, CLASSIC], ids=["fd", "classic"])
def test_candump_shows_what_cantools_encodes(opened, kind):
    bus = opened(driver(received="Tracker", **kind))
    message = cantools.database.load_file(DATABASES / kind["database"]).get_message_by_name("Voltages")
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


def test_time_is_that_of_reception(opened):
    bus = opened(driver(**FD))
    empty_ns = seen_empty(bus)
    ok("cansend", CHANNEL, sensors(1)[0])
    sent_ns = time.monotonic_ns()
    time.sleep(2.0)
    assert all(empty_ns <= sample.time_ns < sent_ns + 1_000_000_000 for sample in taken(bus))


@pytest.mark.parametrize("step_s", [3600, -3600])
def test_stepped_wall_clock_makes_no_sample_old_or_from_the_future(opened, step_wall_clock, step_s):
    bus = opened(driver(**FD))
    newest_ns = 0
    for count in range(0, 40, 4):
        empty_ns = seen_empty(bus)
        ok("cansend", CHANNEL, sensors(count)[0])
        ok("cansend", CHANNEL, sensors(count + 1)[0])
        if count in (8, 24):  # these two wait in the kernel with stamps of the time before
            step_wall_clock(step_s)
        ok("cansend", CHANNEL, sensors(count + 2)[0])
        samples = taken(bus)
        now_ns = time.monotonic_ns()
        assert len(samples) == 3 * len(bus.inputs)
        for sample in samples:
            assert max(empty_ns, newest_ns) <= sample.time_ns <= now_ns
            newest_ns = sample.time_ns


def test_frames_that_did_not_fit_are_counted(opened):
    usual = RECEIVE_BUFFER.read_text()
    RECEIVE_BUFFER.write_text("4096")
    try:
        bus = opened(driver(**FD))
    finally:
        RECEIVE_BUFFER.write_text(usual)
    count = 500
    ok("cangen", CHANNEL, "-g", "0", "-n", str(count), "-I", "101", "-f", "-b", "-L", "18", "-D", "r")
    seen_empty(bus)
    kept = bus.statistics()["frames_in"]
    assert 0 < kept < count
    ok("cansend", CHANNEL, sensors(1)[0])  # the kernel tells with the next frame that it takes
    seen_empty(bus)
    assert bus.statistics()["frames_in"] == kept + 1
    assert bus.statistics()["overflows"] == count - kept


def test_interface_that_goes_down_is_a_lost_link_and_comes_back(opened):
    bus = opened(driver(**FD))
    rest = [0.0] * len(bus.outputs)
    set_link("down")
    with pytest.raises(LinkError, match=r"^socketcan-vcan0, receiving: Network is down$"):
        bus.receive(Inbox(), time.monotonic_ns() + PATIENCE_NS)
    with pytest.raises(LinkError, match=r"^socketcan-vcan0, sending: .*Network is down"):
        bus.perform(0, rest, Inbox())
    bus.close()
    with pytest.raises(LinkError, match=r"^socketcan-vcan0: vcan0 is down; as root: ip link set vcan0 up "):
        bus.open()
    set_link("up")
    bus.open()
    with Dump(1) as dump:
        bus.perform(0, rest, Inbox())
        assert [frame[:6] for frame in dump.frames()] == ["100##1"]
    ok("cansend", CHANNEL, sensors(1)[0])
    assert len(taken(bus)) == len(bus.inputs)


def test_interface_that_is_taken_away_is_a_lost_link(opened):
    ok("ip", "link", "add", "vcan1", "type", "vcan")
    set_link("up", channel="vcan1")
    bus = opened(driver(**FD, channel="vcan1"))
    ok("ip", "link", "delete", "vcan1")
    with pytest.raises(LinkError, match=r"^socketcan-vcan1, receiving: "):
        bus.receive(Inbox(), time.monotonic_ns() + PATIENCE_NS)
    with pytest.raises(LinkError, match=r"there is no network interface vcan1; CAN interfaces here: vcan0$"):
        bus.open()


def test_interfaces_that_can_not_serve_say_why(opened):
    with pytest.raises(LinkError, match=r"there is no network interface can7; CAN interfaces here: vcan0$"):
        driver(**FD, channel="can7").open()
    with pytest.raises(LinkError, match="the network interface lo is not a CAN bus"):
        driver(**FD, channel="lo").open()
    set_link("down")
    set_link("mtu", "16")
    set_link("up")
    try:
        with pytest.raises(LinkError, match="vcan0 has no CAN FD; as root: ip link set vcan0 down, then "):
            driver(**FD).open()
        opened(driver(received="SensorsX", **CLASSIC))
    finally:
        set_link("down")
        set_link("mtu", "72")


def test_full_transmit_queue_is_told_and_leaves_no_gap_in_the_count(opened):
    bus = opened(driver(**FD))
    rest = [0.0] * len(bus.outputs)
    ok("tc", "qdisc", "add", "dev", CHANNEL, "root", "netem", "delay", "200s", "limit", "3")
    try:
        for _ in range(3):
            bus.perform(0, rest, Inbox())
        for _ in range(2):
            with pytest.raises(TransientError, match=r"No buffer space available .*\(transmit buffer full\)$"):
                bus.perform(0, rest, Inbox())
    finally:
        ok("tc", "qdisc", "delete", "dev", CHANNEL, "root")
    assert bus.statistics()["transmit_full"] == 2
    with Dump(1) as dump:
        bus.perform(0, rest, Inbox())
        assert [frame[-2:] for frame in dump.frames()] == ["03"]


def test_second_controller_on_the_bus_is_a_fault(opened):
    bus = opened(driver(**FD))
    ok("cansend", CHANNEL, f"100##1{bytes(8).hex()}")
    with pytest.raises(DeviceFault, match="somebody else sends Voltages on socketcan-vcan0"):
        bus.receive(Inbox(), time.monotonic_ns() + PATIENCE_NS)
