"""Moments in which machine or bus stood still, recorded in ``stalls.csv`` and played again in virtual time.

``held``: for so long the capacitive sensor's samples say what they said before, dated as fresh, as where a device or
its bus stood still and the loop did not. ``false``: one sample belongs to another time, 20 um away. ``missed``: the
loop stood still, the machining went on. Beside each moment stands what the stage did on c9ccc00 in the 100 ms after it:
largest and rms departure (um) from a run without the moment; of those that were missed, the path error itself, because
nobody could have prevented what happened meanwhile, and on simulated.yaml as it was tuned on 2026-11-25.
"""

import csv
import ctypes
from pathlib import Path

import numpy as np
import pytest

from micromanip.bus.bridge import BusBridge
from micromanip.bus.cyclic import EXCHANGE_C
from micromanip.bus.driver import BusOptions, Channel, Task
from micromanip.bus.image import ProcessImage
from micromanip.bus.safe_state import VOLTAGE, Beginning, SafeOutput, SafeState
from micromanip.replay.kernel import NO_SWAP, NOTHING_DIFFERS, replay_rows
from micromanip.rt.bus_exchange import exchange_image
from micromanip.rt.bus_image import ALIVE_NS, EPOCH, EPOCH_SEEN, IMAGE, LINK, LINK_UP, OUTPUT_STATE
from micromanip.rt.bus_image import FOLLOWING as FOLLOWING_BUS
from micromanip.rt.io.gate import note_sent, note_taken
from micromanip.rt.io.link_gate import FOLLOWING, LINK_GATE, acknowledge, has_sent, near, put_back
from micromanip.rt.jit import plain
from micromanip.rt.records import MAX_AXES, MAX_OUTPUTS, MAX_SIGNALS, SIGNAL
from micromanip.rt.states import NO_FAULT, TRACKING
from micromanip.rt.telemetry import DEVICE_ABOVE, DEVICE_BELOW
from micromanip.settings.check import prepare
from micromanip.virtual.cell import VirtualCell

ROOT = Path(__file__).parents[2]
RECORDED = Path(__file__).with_name("stalls.csv")
LATE_AXES = Path(__file__).with_name("late_axes.yaml")
WINDOW_S = 0.1
PERIOD_NS = 100_000


def recorded(name, kind):
    """The moments of one cell and kind."""
    with RECORDED.open(encoding="utf-8", newline="") as file:
        return [row for row in csv.DictReader(file) if (row["cell"], row["kind"]) == (name, kind)]


def cell(folder, name, faults=""):
    """The example, tracking, with `faults` scheduled."""
    text = (ROOT / "config" / f"{name}.yaml").read_text(encoding="utf-8")
    return running(folder, text.replace("    seed: 1\n", f"    seed: 1\n{faults}", 1))[0]


def until(tracking, at_s):
    """Rows of the time until `at_s` after the start."""
    return tracking.run(at_s - float(tracking.state[0]["cycle"]) * 1e-4)


def courses(folder, name, kind, moments):
    """What axis x did in the time after each moment (moments, cycles): um."""
    if kind == "missed":
        tracking, found = cell(folder, name), []
        for moment in moments:
            until(tracking, float(moment["at_s"]))
            rows = tracking.run(WINDOW_S, periods=1 + round(10 * float(moment["ms"])))
            found.append(rows["axis"]["path_error_um"][:, 0])
        return tracking, np.array(found)
    what = {"held": "kind: freeze, for_s: {:g}", "false": "kind: spike, value: 20.0"}[kind]
    lines = [
        f"      - {{at_s: {moment['at_s']}, channel: stage_x, {what.format(1e-3 * float(moment['ms']))}}}\n"
        for moment in moments
    ]
    upset, calm = cell(folder, name, "    faults:\n" + "".join(lines)), cell(folder, name)
    found = []
    for moment in moments:
        until(upset, float(moment["at_s"])), until(calm, float(moment["at_s"]))
        rows, usual = upset.run(WINDOW_S), calm.run(WINDOW_S)
        found.append((rows["axis"]["true_stage_um"] - usual["axis"]["true_stage_um"])[:, 0])
    return upset, np.array(found)


def figures(found):
    """Largest and rms departure of each moment."""
    return np.abs(found).max(axis=1), np.sqrt(np.mean(found**2, axis=1))


@pytest.mark.long
@pytest.mark.parametrize(
    ("name", "kind", "share"),
    [
        ("simulated", "held", 1.0 / 3.0),
        ("simulated", "false", 1.0 / 3.0),
        ("simulated_1khz", "false", 1.0 / 3.0),
        ("simulated_1khz", "held", 1.0),
        ("simulated", "missed", 1.1),
        ("simulated_1khz", "missed", 1.1),
    ],
)
def test_what_a_stall_leaves_behind(tmp_path, name, kind, share):
    moments = recorded(name, kind)
    assert len(moments) == 8
    tracking, found = courses(tmp_path, name, kind, moments)
    assert (tracking.state[0]["state"], tracking.state[0]["fault"]) == (TRACKING, NO_FAULT)
    for column, now in zip(("max_um", "rms_um"), figures(found), strict=True):
        before = np.array([float(moment[column]) for moment in moments])
        assert np.sqrt(np.mean(now**2)) <= share * np.sqrt(np.mean(before**2)), (column, now, before)
        assert now.max() <= share * before.max(), (column, now, before)


def of_a_burst():
    """Periods of the cycles in 150 ms of a machine that was given to others: 84 gaps of 2 to 32 periods."""
    with Path(__file__).with_name("burst.csv").open(encoding="utf-8", newline="") as file:
        gaps = [(int(row["cycles_since"]), int(row["periods"])) for row in csv.DictReader(file)]
    return [periods for since, gap in gaps for periods in [1] * (since - 1) + [gap]]


@pytest.mark.long
@pytest.mark.parametrize("at_s", [6.0, 8.3])
def test_a_burst_of_missed_cycles_makes_nothing_swing(tmp_path, at_s):
    """With one gain for all gaps and a loop that went on, the stage swung by 1 mm, until X-216 blamed the gains."""
    tracking = cell(tmp_path, "simulated")
    until(tracking, at_s)
    before = tracking.run(WINDOW_S)
    rows = np.concatenate([*(tracking.run(1e-4, periods=each) for each in of_a_burst()), tracking.run(WINDOW_S)])
    assert (rows["periods"] - 1).sum() > 400
    assert (tracking.state[0]["state"], tracking.state[0]["fault"]) == (TRACKING, NO_FAULT)
    axes = rows["axis"]
    assert np.abs(axes["innovation_um"]).max() < 50.0
    assert np.abs(axes["path_error_um"]).max() < 60.0, "before, 180"
    tracking.run(4 * WINDOW_S)
    after = tracking.run(WINDOW_S)
    rms = (np.sqrt(np.mean(each["axis"]["path_error_um"] ** 2)) for each in (before, after))
    assert next(rms) == pytest.approx(next(rms), rel=0.5)


def bursts(share, shortest, longest, cycles):
    """So many cycles, of which a share comes late by some periods."""
    return lambda rng: np.where(rng.random(cycles) < share, rng.integers(shortest, longest + 1, cycles), 1)


BEHIND_A_BUS = {
    "60 periods": lambda _: [60],
    "400 periods": lambda _: [400],
    "30 of 2 to 8": bursts(0.5, 2, 8, 30),
    "40 of 2 to 20": bursts(0.3, 2, 20, 40),
    "200 of 2 to 5": bursts(0.2, 2, 5, 200),
    "84 in 150 ms": lambda _: of_a_burst(),
}
"""Periods of the cycles of a moment."""


def behind_a_bus(folder):
    """The simulated cell, its voltages a cycle later, with axes that were commissioned so; tracking, and its wiring."""
    cell, _ = (ROOT / "config" / "simulated.yaml").read_text(encoding="utf-8").split("\naxes:\n")
    text = cell + "\n" + LATE_AXES.read_text(encoding="utf-8")
    text = text.replace("max_age_us: 300,", "max_age_us: 1000,")
    text = text.replace("    seed: 1\n", "    seed: 1\n    plant: {late_cycles: 1}\n", 1)
    for name in "yz":
        text = text.replace(f"      {name}: {{", f"      {name}: {{late_cycles: 1, ", 1)
    return running(folder, text)


def running(folder, text):
    """The cell of a configuration, armed, and its wiring."""
    file = folder / "cell.yaml"
    file.write_text(text, encoding="utf-8")
    prepared = prepare(file)
    tracking = VirtualCell(prepared.parameters, prepared.wiring)
    tracking.arm()
    return tracking, prepared.wiring


def waiting(folder):
    """The simulated cell as it is: as behind a wire whose answers the loop waits for, and tracking; its wiring."""
    text = (ROOT / "config" / "simulated.yaml").read_text(encoding="utf-8")
    return running(folder, text.replace("max_age_us: 300,", "max_age_us: 1000,"))  # as ethercat.yaml allows


@pytest.mark.long
@pytest.mark.parametrize("moments", BEHIND_A_BUS)
def test_axes_behind_a_bus_come_back_from_every_stall(tmp_path, moments):
    """As fast as their margins allow: by their own gains the error that these left ran from end to end, to X-216."""
    tracking, _ = behind_a_bus(tmp_path)
    until(tracking, 6.0)
    before = np.sqrt(np.mean(tracking.run(WINDOW_S)["axis"]["path_error_um"] ** 2))
    rng = np.random.default_rng(7)
    for moment in range(10):
        errors = [tracking.run(1e-4, periods=each) for each in BEHIND_A_BUS[moments](rng)]
        errors.append(tracking.run(0.15 + 0.013 * moment))
        error_um = np.concatenate(errors)["axis"]["path_error_um"]
        assert tracking.state[0]["fault"] == NO_FAULT, moment
        assert np.abs(error_um).max() < 120.0, moment
        assert np.sqrt(np.mean(error_um[-300:] ** 2)) < 3.0 * before, moment


def at(address, dtype, count):
    """The array at an address."""
    return np.frombuffer((ctypes.c_char * (count * np.dtype(dtype).itemsize)).from_address(address), dtype)


class Wire:
    """Put between the loop and the cell's driver: frames that come back late, behind the gate of a real wire.

    The driver acts on a frame, and measures, in the cycle in which it is sent. Sensors and acknowledgement come `late`
    cycles after those of a frame in time, in their order; what the cell alone knows, and the tracker, are in time.
    """

    def __init__(self, tracking, inputs):
        self.late, self.on_the_way = 0, []
        self.sensors = [inputs.index(f"{kind}_{name}") for kind in ("strain", "stage") for name in "xyz"]
        self.others = [k for k in range(len(inputs)) if k not in self.sensors]
        self.measured = tracking.signals.copy()
        self.gate = np.zeros(1, LINK_GATE)[0]
        self.gate["outputs"], self.gate["state"] = 3, FOLLOWING
        for i in range(3):
            self.gate["step"][i] = tracking.parameters[0]["axis"]["limiter"]["slew_V"][i]
            for of_the_device in ("last", "lowest", "highest"):
                self.gate[of_the_device][i] = tracking.outputs[i]
        driver = tracking._drivers[0]
        self._cell, self._context = EXCHANGE_C(int(driver["exchange"])), int(driver["context"])
        self._exchange = EXCHANGE_C(self.exchange)
        driver["exchange"] = ctypes.cast(self._exchange, ctypes.c_void_p).value

    def exchange(self, _, outputs_at, inputs_at, now_ns, periods):
        """As the loop calls it."""
        outputs, inputs, gate = at(outputs_at, float, MAX_OUTPUTS), at(inputs_at, SIGNAL, MAX_SIGNALS), self.gate
        for i in range(3):
            gate["last"][i] = near(gate, i, outputs[i])
        has_sent(gate)
        put_back(gate, outputs)
        code = self._cell(self._context, gate["last"].ctypes.data, self.measured.ctypes.data, now_ns, periods)
        inputs[self.others] = self.measured[self.others]
        self.on_the_way.append((now_ns + self.late * PERIOD_NS, int(gate["sent_count"]), self.measured.copy()))
        while self.on_the_way and self.on_the_way[0][0] <= now_ns:
            _, count, measured = self.on_the_way.pop(0)
            acknowledge(gate, int(gate["sent_count"]) - count)
            inputs[self.sensors] = measured[self.sensors]
        return code


def replayed(parameters, state, rows):
    """The rows once more, of what they say came in."""
    again, commands = np.zeros_like(rows), np.zeros(len(rows), np.int64)
    image = np.zeros(MAX_SIGNALS, SIGNAL), np.zeros(MAX_OUTPUTS), np.zeros((1, MAX_AXES))
    both = np.concatenate([parameters, parameters])
    replay_rows(both, state, *image, rows, commands, again, NO_SWAP, 0, *NOTHING_DIFFERS)
    return again


LATE = {
    "four cycles for 20 ms": ([4] * 200, 40.0),
    "answered in four cycles of 24": ([*range(20, 0, -1), 0, 0, 0, 0] * 10, 60.0),
}
"""By how many cycles the frame of each cycle is late, none of them missed; what the path error stays below, um."""


@pytest.mark.long
@pytest.mark.parametrize("frames", LATE)
@pytest.mark.parametrize("at_s", [6.0, 8.3])
@pytest.mark.parametrize("of", [behind_a_bus, waiting])
def test_frames_that_come_late_make_nothing_swing(tmp_path, of, at_s, frames):
    """Its voltages held back, and nobody told, the loop drove a stage that hardly followed from end to end."""
    tracking, wiring = of(tmp_path)
    until(tracking, at_s)
    wire, rows = Wire(tracking, wiring.drivers["cell"].inputs), []
    before = tracking.state.copy()
    late, most_um = LATE[frames]
    for wire.late in late + 500 * [0]:
        rows.append(tracking.run(1e-4))
    assert wire.gate["held_back"] > 0
    assert tracking.state[0]["fault"] == NO_FAULT
    played = np.concatenate(rows)
    assert np.abs(played["axis"]["path_error_um"]).max() < most_um, "before, up to 460 um"
    assert not tracking.state[0]["order"]["behind"].any()
    again = replayed(tracking.parameters, before, played)
    assert np.array_equal(again["axis"]["voltage_V"], played["axis"]["voltage_V"])


class Turns:
    """Put between the loop and the cell's driver: a worker that gives 2000 times a second, and never while it `stands`.

    Image, safe state and bridge are the true ones. The sensors come by another bus, and go on.
    """

    inputs, outputs = (), tuple(Channel(f"voltage_{name}", 2000.0) for name in "xyz")

    def __init__(self, tracking):
        self.record = BusBridge(self, BusOptions(), 10**12).context().view(IMAGE)
        self.image, self.stands, self.cycles = ProcessImage(self.record), False, 0
        tasks = [Task("turn", 2000.0, (0, 1, 2))]
        self.safe = SafeState([SafeOutput(VOLTAGE, 0.0, -20.0, 150.0, 40e3)] * 3, tasks, 0.2, 10**12)
        for i, volts in enumerate(tracking.outputs[:3].tolist()):
            self.safe.begin(i, Beginning(volts, (volts, volts)))
        self.safe.fields["state"][0] = FOLLOWING_BUS
        self.given = tracking.outputs.copy()
        for word, value in ((EPOCH_SEEN, 1), (EPOCH, 1), (LINK, LINK_UP), (OUTPUT_STATE, FOLLOWING_BUS)):
            self.image.tell(word, value)
        driver = tracking._drivers[0]
        self._cell, self._context = EXCHANGE_C(int(driver["exchange"])), int(driver["context"])
        self._exchange = EXCHANGE_C(self.exchange)
        driver["exchange"] = ctypes.cast(self._exchange, ctypes.c_void_p).value
        self.turn(int(tracking.state[0]["cycle"]) * PERIOD_NS)

    def turn(self, now_ns):
        """Give what the gate lets through."""
        wanted, written_ns = self.image.wanted()
        self.safe.decide((wanted if written_ns else self.given)[:3].tolist(), written_ns, now_ns)
        plain(note_sent)(self.safe.fields, 0, now_ns, now_ns)
        plain(note_taken)(self.safe.fields, 0, now_ns)
        self.given[:3] = self.safe.values
        self.image.tell_turn(range(3), now_ns)
        self.image.remember_sent(self.safe.last, now_ns)

    def exchange(self, _, outputs_at, inputs_at, now_ns, periods):
        """As the loop calls it."""
        self.image.tell(ALIVE_NS, now_ns)
        exchange_image(self.record[0], at(outputs_at, float, MAX_OUTPUTS), np.zeros(0, SIGNAL), now_ns)
        self.cycles += periods
        if self.cycles % 5 == 0 and not self.stands:
            self.turn(now_ns)
        return self._cell(self._context, self.given.ctypes.data, inputs_at, now_ns, periods)


STANDS = {
    "25 ms of 100": (([True] * 250 + [False] * 750) * 5, 130.0),
    "8 ms of 50": (([True] * 80 + [False] * 420) * 10, 80.0),
    "three turns of four": (([True] * 15 + [False] * 5) * 100, 25.0),
}
"""Whether the worker stands in each cycle; what the path error stays below, um. Before, 530, 130 and 20."""


@pytest.mark.long
@pytest.mark.parametrize("moments", STANDS)
@pytest.mark.parametrize("at_s", [6.0, 8.3])
def test_a_worker_that_stands_still_makes_nothing_swing(tmp_path, at_s, moments):
    """With sensors that went on, and nobody told, the loop acted by feedback on a stage that could not follow."""
    tracking = cell(tmp_path, "simulated_2khz")
    until(tracking, at_s)
    bus, rows = Turns(tracking), []
    undisturbed = tracking.run(WINDOW_S)["axis"]["fresh"]
    assert not (undisturbed & (DEVICE_BELOW | DEVICE_ABOVE)).any()
    before = tracking.state.copy()
    stands, most_um = STANDS[moments]
    for bus.stands in stands + 500 * [False]:
        rows.append(tracking.run(1e-4))
    assert tracking.state[0]["fault"] == NO_FAULT
    played = np.concatenate(rows)
    assert np.abs(played["axis"]["path_error_um"]).max() < most_um
    assert not tracking.state[0]["order"]["behind"].any()
    again = replayed(tracking.parameters, before, played)
    assert np.array_equal(again["axis"]["voltage_V"], played["axis"]["voltage_V"])


@pytest.mark.long
def test_a_path_that_went_on_while_the_loop_stood_still_is_found_again(tmp_path):
    """It moves further in these 40 ms than a tracker may jump, and there was X-301 half a second later."""
    tracking = cell(tmp_path, "simulated")
    until(tracking, 4.037)
    before = tracking.run(1e-4)["axis"]["deviation_um"][-1]
    axes = tracking.run(0.6, periods=400)["axis"]
    assert np.abs(axes["deviation_um"][20] - before).max() > tracking.parameters[0]["axis"]["reference"]["jump_um"][0]
    assert (tracking.state[0]["state"], tracking.state[0]["fault"]) == (TRACKING, NO_FAULT)
    assert np.abs(axes["path_error_um"][-1000:]).max() < 5.0
