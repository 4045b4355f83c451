"""The watchdog of the played amplifier, in the plant's place a recorder of what it is told."""

import itertools
import math

import numpy as np
import pytest

from micromanip.emulation.amplifier import ARRIVED, Amplifier

MS = 1_000_000
REST = {"voltage_x": 0.0, "voltage_y": -5.0}


class Told:
    def __init__(self):
        self.now = {}

    def write(self, name, value):
        self.now[name] = value


class Scene:
    def __init__(self, watchdog_ms=20.0):
        self.told = Told()
        self.amplifier = Amplifier(self.told, REST, watchdog_ms)
        self.ns = 0

    def tick(self, milliseconds, **commands):
        """Let time pass, a millisecond at a time; what the plant was told of x at each."""
        course = []
        for _ in range(milliseconds):
            self.ns += MS
            if commands:
                self.amplifier.take(commands, self.ns)
            self.amplifier.tick(self.ns, self.ns)
            course.append(self.told.now["voltage_x"])
        return course


@pytest.fixture
def scene():
    return Scene()


def test_silence_ramps_to_rest_in_a_fifth_of_a_second(scene):
    scene.tick(50, voltage_x=60.0, voltage_y=10.0)
    assert set(scene.tick(20)) == {60.0}
    assert scene.amplifier.ok
    course = scene.tick(205)
    assert not scene.amplifier.ok
    assert all(later <= earlier for earlier, later in itertools.pairwise(course))
    assert max(abs(b - a) for a, b in itertools.pairwise(course)) < 0.5, "no step that rings the stage"
    assert scene.told.now == REST


def test_an_output_that_no_command_has_reached_stays_at_rest(scene):
    """Compiled code counted a command of the other one, and says so."""
    record = np.zeros(1, ARRIVED)[0]
    scene.amplifier.count_in("voltage_x", record)
    record["last"] = 60.0
    scene.amplifier.has_taken(MS)
    assert scene.amplifier.in_force == {"voltage_x": 60.0, "voltage_y": -5.0}


def test_a_tripped_one_follows_again_only_from_rest(scene):
    scene.tick(50, voltage_x=60.0, voltage_y=10.0)
    scene.tick(300)
    scene.tick(50, voltage_x=60.0, voltage_y=-5.0)
    assert scene.told.now == REST
    assert not scene.amplifier.ok
    scene.tick(1, voltage_x=0.3, voltage_y=-5.2)
    assert scene.amplifier.ok
    scene.tick(1, voltage_x=30.0, voltage_y=0.0)
    assert scene.told.now["voltage_x"] == 30.0
    assert scene.amplifier.trips == 1


def test_rest_while_it_still_ramps_does_not_make_it_jump(scene):
    scene.tick(50, voltage_x=60.0, voltage_y=10.0)
    scene.tick(25)
    course = scene.tick(100, voltage_x=0.0, voltage_y=-5.0)
    assert course[0] > 50.0
    assert not scene.amplifier.ok


def test_its_own_stall_is_no_silence_of_the_controller(scene):
    scene.tick(10, voltage_x=60.0, voltage_y=0.0)
    scene.ns += 300 * MS
    scene.tick(15)
    assert scene.amplifier.ok
    scene.tick(10)
    assert not scene.amplifier.ok


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
def test_what_is_no_number_is_refused_whole_and_does_not_feed_the_watchdog(scene, bad):
    scene.tick(5, voltage_x=60.0, voltage_y=0.0)
    scene.tick(30, voltage_x=10.0, voltage_y=bad)
    assert scene.amplifier.refused == 30
    assert not scene.amplifier.ok
