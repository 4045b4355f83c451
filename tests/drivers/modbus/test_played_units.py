"""The driver on the units that `device simulate` plays, over TCP and a pseudo terminal, with faults of the line."""

import re
import time

import pytest
from micromanip_drivers.modbus.driver import Modbus

from micromanip.bus.errors import LinkError, TransientError
from micromanip.bus.inbox import Inbox

from .played import keys_of, played, until

pytestmark = pytest.mark.realtime  # answers within time-outs

FILES = pytest.mark.parametrize("name", ["modbus.yaml", "modbus_rtu.yaml"], ids=["tcp", "rtu"])


@pytest.fixture
def unit(tmp_path, name):
    with played(tmp_path, name) as it:
        yield it


class Cycle:
    """Turns of the one task, as a worker does them."""

    def __init__(self, unit, **keys):
        self.driver = Modbus(Modbus.Options.model_validate({**keys_of(unit.config), **keys}), None)
        self.names = [channel.name for channel in self.driver.inputs]
        self.outputs = [channel.name for channel in self.driver.outputs]
        self.values, self.errors = {}, []

    def __enter__(self):
        until(self.opened)
        return self

    def opened(self):
        """A busy machine may answer late once."""
        try:
            self.driver.open()
        except LinkError:
            return False
        return True

    def __exit__(self, *_):
        self.driver.close()

    def turn(self, **outputs):
        inbox = Inbox()
        try:
            self.driver.perform(0, [outputs.get(name.split(".")[1], 0.0) for name in self.outputs], inbox)
            self.driver.receive(inbox, time.monotonic_ns() + 50_000_000)
        except TransientError as problem:
            self.errors.append(str(problem))
            time.sleep(0.005)
        self.values |= {self.names[one.channel].split(".")[1]: one.value for one in inbox}
        return len(inbox) > 0

    def turns(self, count, **outputs):
        return sum(self.turn(**outputs) for _ in range(count))


@FILES
def test_an_axis_moves(unit):
    with Cycle(unit) as cycle:
        until(lambda: cycle.turn(amplifier_enable=1.0))
        low = cycle.values["strain_y"]
        cycle.turns(30, amplifier_enable=1.0, voltage_y=40.0)
        assert 15.0 < cycle.values["strain_y"] - low < 80.0
        assert abs(cycle.values["strain_x"] - low) < 5.0
        assert cycle.values["enable"] == 1.0
        assert cycle.values["amplifier_ok_y"] == 1.0
    assert unit.do(unit.devices.report)["outputs"]["voltage_y"]["max"] == 40.0


@FILES
@pytest.mark.parametrize(
    ("fault", "said"),
    [
        ('{"inject": "exception", "code": 6, "share": 0.5}', "exception 6, busy"),
        ('{"inject": "short", "share": 0.3}', "only|no answer|something else"),
        ('{"inject": "garbage", "share": 0.3}', "something else|no answer"),
        ('{"inject": "drop", "share": 0.35}', "no answer"),
        ('{"inject": "delay", "ms": 40, "share": 0.35}', "no answer"),
        ('{"inject": "split", "gap_ms": 2}', None),
    ],
    ids=["busy", "short", "garbage", "drop", "late", "split"],
)
def test_a_disturbed_line_is_found_again(unit, fault, said):
    """Every value is one that the sensors had: 0.32 um or so at rest, and digital lines that are on."""
    with Cycle(unit) as cycle:
        until(lambda: cycle.turn(amplifier_enable=1.0))
        at_rest = dict(cycle.values)
        assert "ok" in unit.order(fault), fault
        for _ in range(25):
            try:
                cycle.turn(amplifier_enable=1.0)
            except LinkError:
                cycle.driver.close()
                until(cycle.opened)
            for name in ("strain_x", "strain_y", "strain_z"):
                assert abs(cycle.values[name] - at_rest[name]) < 2.0, "a value that no sensor had"
            assert cycle.values["enable"] == cycle.values["interlock"] == 1.0
        unit.order('{"device": "clear"}')
        until(lambda: cycle.turn(amplifier_enable=1.0))
        if said is not None:
            assert any(re.search(said, error) for error in cycle.errors), cycle.errors


@FILES
@pytest.mark.parametrize(
    ("kind", "lost", "most", "shut"),
    [("hang", "3 times in a row", 2000, None), ("unplug", "is gone", 50, "can't be opened")],
    ids=["hangs", "unplugged"],
)
def test_a_device_that_is_away_is_a_lost_link_and_comes_back(unit, kind, lost, most, shut):
    with Cycle(unit) as cycle:
        until(lambda: cycle.turn(amplifier_enable=1.0))
        unit.order(f'{{"inject": "{kind}"}}')
        with pytest.raises(LinkError, match=lost):
            cycle.turns(most)
        cycle.driver.close()
        with pytest.raises(LinkError, match=shut):
            cycle.driver.open()
        cycle.driver.close()
        unit.order('{"device": "clear"}')
        until(cycle.opened)
        until(lambda: cycle.turn(amplifier_enable=1.0))
