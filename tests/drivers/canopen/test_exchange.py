"""Driver and test nodes together: boot, values both ways, time stamps, what each watches."""

import time

import pytest
from canopen import SdoAbortedError

from micromanip.bus.errors import DeviceFault, IdentityMismatch, LinkError
from micromanip.bus.inbox import Inbox
from micromanip.emulation.can.canopen_node import OPERATIONAL, PRE_OPERATIONAL
from micromanip.emulation.can.canopen_objects import WRONG_VALUE

from .cell import AMPLIFIER, EDS, SENSOR, cell, run, wait_for

pytestmark = pytest.mark.realtime  # heartbeats and time-outs of 60 ms

PARK = (0.0, 0.0, 0.0)


@pytest.fixture
def at():
    with cell() as at:
        yield at


@pytest.fixture
def opened(at):
    bus = at.driver()
    bus.open()
    yield bus
    bus.close()


def seen(bus, samples):
    return {bus.inputs[sample.channel].name: sample.value for sample in samples}


def test_amplifier_makes_its_outputs_safe_when_we_are_gone(at, opened):
    assert opened.watchdog == "RPDO event timer of amplifier, 200 ms"
    run(opened, (50.0, 50.0, 50.0), lambda _: at.values.get("voltage_x") == 50.0)
    wait_for(lambda: at.values["voltage_x"] == 0.0)  # nobody performs any more
    wait_for(lambda: at.nodes["amplifier"].state == PRE_OPERATIONAL)


def test_watchdog_by_our_heartbeat(at):
    bus = at.driver(nodes__amplifier__watchdog_by="heartbeat", nodes__amplifier__watchdog_ms=60)
    assert bus.watchdog == "consumer heartbeat of amplifier, 60 ms"
    assert any(task.name == "heartbeat" and task.rate_hz == 50.0 for task in bus.tasks)
    bus.open()
    run(bus, (50.0, 50.0, 50.0), lambda _: at.values.get("voltage_x") == 50.0)
    beat = next(i for i, task in enumerate(bus.tasks) if task.name == "heartbeat")
    end_ns = time.monotonic_ns() + 180_000_000
    while time.monotonic_ns() < end_ns:  # our heartbeat alone, three times as long as the watchdog
        bus.perform(beat, PARK, Inbox())
        time.sleep(0.002)
    assert at.values["voltage_x"] == 50.0
    wait_for(lambda: at.values["voltage_x"] == 0.0)
    bus.close()


def test_running_again_after_having_been_left_alone(at, opened):
    run(opened, (50.0, 0.0, 0.0), lambda _: at.values.get("voltage_x") == 50.0)
    wait_for(lambda: at.values["voltage_x"] == 0.0)
    with pytest.raises((DeviceFault, LinkError), match="amplifier"):
        run(opened, PARK, lambda _: False)
    opened.close()
    opened.open()
    assert at.values["voltage_x"] == 0.0
    run(opened, (20.0, 0.0, 0.0), lambda _: at.values["voltage_x"] == 20.0)


def test_a_worker_that_was_held_up_misses_no_heartbeat(at):
    bus = at.driver(nodes__amplifier__watchdog_ms=None)
    bus.open()
    run(bus, PARK, lambda samples: len(samples) >= 6)
    time.sleep(0.4)  # heartbeats wait in the socket meanwhile
    run(bus, PARK, lambda samples: len(samples) >= 60)
    bus.close()


def test_what_a_node_says_comes_before_what_it_does(at, opened):
    run(opened, PARK, lambda samples: len(samples) >= 6)
    wait_for(lambda: at.nodes["amplifier"].state == PRE_OPERATIONAL)  # it has tripped, and said so before
    time.sleep(0.2)  # until it has said where it is, too: all is there when the driver looks

    def heard():
        opened.receive(Inbox(), time.monotonic_ns())

    with pytest.raises(DeviceFault, match=r"amplifier reports emergency 0x8250 \(no outputs in time\)"):
        wait_for(heard)


def test_rebooted_node(at, opened):
    run(opened, PARK, lambda samples: len(samples) >= 6)
    at.do(at.nodes["sensor"].reboot)
    with pytest.raises(LinkError, match=r"node sensor has restarted \(boot-up message\)"):
        run(opened, PARK, lambda _: False)
    opened.close()
    opened.open()
    run(opened, PARK, lambda samples: len(samples) >= 6)


def test_stopped_by_somebody_else(at, opened):
    run(opened, PARK, lambda samples: len(samples) >= 6)
    at.at.send(0x000, bytes((2, SENSOR)))
    with pytest.raises(LinkError, match="node sensor is STOPPED, no longer OPERATIONAL"):
        run(opened, PARK, lambda _: False)


def test_emergency_and_its_end(at, opened):
    run(opened, PARK, lambda samples: len(samples) >= 6)
    at.do(lambda: at.nodes["amplifier"].emergency(0x4210, 0x09))
    with pytest.raises(DeviceFault, match=r"node amplifier reports emergency 0x4210 \(temperature\), .* 0x09"):
        run(opened, PARK, lambda _: False)
    opened.close()
    with pytest.raises(DeviceFault, match=r"node amplifier reports error register 0x[01]9, last emergency 0x4210"):
        opened.open()  # still too hot
    wait_for(lambda: at.nodes["amplifier"].objects.raw(0x1003, 1) == 0x8250)  # it missed us meanwhile as well
    with pytest.raises(DeviceFault, match=r"node amplifier reports error register 0x19, last emergency 0x4210"):
        opened.open()
    at.do(at.nodes["amplifier"].clear_emergency)
    opened.open()
    run(opened, PARK, lambda samples: len(samples) >= 6)


def test_another_device_with_that_number():
    with cell(amplifier=False) as at:
        at.add("amplifier", AMPLIFIER, EDS / "tracker.eds")
        bus = at.driver()
        with pytest.raises(IdentityMismatch, match=r"refuses to read 1400sub1 .*is amplifier.eds its EDS file\?"):
            bus.open()


def test_device_with_another_mapping(at):
    objects = at.nodes["sensor"].objects
    objects.put(0x1A01, 1, 0x81300118)  # strain_x where the EDS has strain_y
    with pytest.raises(IdentityMismatch, match=r"tpdo 2 of node sensor is set up otherwise .* 1A01sub1 is 0x81300118"):
        at.driver().open()


def test_mapping_of_our_own(at):
    bus = at.driver(
        nodes__sensor__tpdo={
            2: {
                "rate_hz": 100.0,
                "transmission": 2,
                "map": ["stage_z", "8130sub1"],
                "signals": {"strain": {"object": "strain_x", "scale": 1e-4}, "z": {"object": "stage_z", "scale": 1e-4}},
            }
        }
    )
    at.values |= {"strain_x": 1.5, "stage_z": -2.5}
    bus.open()
    at.do(lambda: None)
    samples = run(bus, PARK, lambda samples: sum(sample.channel == 1 for sample in samples) >= 3)
    values = seen(bus, samples)
    assert values == {"sensor.strain": pytest.approx(1.5), "sensor.z": pytest.approx(-2.5)}
    assert at.nodes["sensor"].objects.raw(0x1801, 2) == 2
    bus.close()


def test_event_driven_pdo(at):
    at.nodes["sensor"].objects.put(0x1800, 5, 5)  # every 5 ms by its own clock
    bus = at.driver(
        nodes__sensor__tpdo={1: {"rate_hz": 200.0, "transmission": "event", "signals": {"strain_x": {"scale": 1e-4}}}},
        sync_hz=None,
    )
    bus.open()
    assert at.nodes["sensor"].state == OPERATIONAL
    samples = run(bus, PARK, lambda samples: len(samples) >= 5)
    assert [sample.value for sample in samples] == pytest.approx([10.0] * len(samples))
    bus.close()


def test_nothing_is_ever_stored(at, opened):
    run(opened, PARK, lambda samples: len(samples) >= 60)
    opened.close()
    opened.open()
    assert [node.objects.stores for node in at.nodes.values()] == [0, 0]


def test_a_node_that_answers_no_remote_frames_keeps_that_bit_and_is_not_written_what_it_has(at):
    written = []
    objects = at.nodes["sensor"].objects
    has, no_remote = objects.raw(0x1800, 1), 0x40000000
    objects.put(0x1800, 1, has | no_remote)

    def refusing(index, subindex, od, data):
        written.append(index)
        if index == 0x1800 and subindex == 1 and not int.from_bytes(data, "little") & no_remote:
            raise SdoAbortedError(WRONG_VALUE)

    objects.node.add_write_callback(refusing)
    bus = at.driver(
        nodes__sensor__tpdo={1: {"rate_hz": 200.0, "transmission": "event", "signals": {"strain_x": {"scale": 1e-4}}}}
    )
    for writes in (True, False):
        bus.open()
        bus.close()
        assert (0x1800 in written) == writes
        written.clear()
    assert objects.raw(0x1800, 1) == has | no_remote
