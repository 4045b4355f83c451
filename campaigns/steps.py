"""What happens in one interleaving, drawn from a seed and its number, and how each step is done on the bench."""

import os
import signal
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field
from random import Random

from micromanip.errors import DeviceUnavailable, MicromanipError, UsageError

from .played.amplifier import READS
from .played.port import CUTS

GOOD_SETS = (
    {"axes.x.inner.K_V_per_um": 0.06},
    {"axes.x.setpoint.slew_um_per_ms": 0.3},
    {"faults.link.loop_silent_ms": 40.0},
    {"faults.link.silent_ms": 150.0},
    {"start.ramp_s": 0.25},
    {"outputs.voltage_x.range_V": [-10, 90]},
    {"outputs.voltage_y.slew_V_per_ms": 0.4},
    {"outputs.voltage_x.range_V": [-10, 70], "outputs.voltage_y.range_V": [0, 80]},
    {"axes.x.mode": "voltage"},
    {"axes.y.centre_um": 50.0},
    {"reference.offset_um": 40.0},
)
"""Some are refused while an axis tracks."""
BAD_SETS = (
    {"outputs.voltage_x.range_V": [100, -20]},
    {"outputs.voltage_x.park_V": 50.0},
    {"outputs.voltage_y.slew_V_per_ms": 0.0},
    {"start.ramp_s": 1e300},
    {"axes.x.inner.K_V_per_um": "fast"},
    {"faults.link.silent_ms": 1e300},
)
SPOILT = {
    "park out of range": ("park_V: 0", "park_V: 110"),
    "range upside down": ("range_V: [-20, 100]", "range_V: [100, -20]"),
    "misspelt section": ("outputs:", "output:"),
    "not a number": ("park_V: 0", "park_V: .nan"),
    "no slew": ("slew_V_per_ms: 0.5", "slew_V_per_ms: 0"),
    "ramp of no time": ("ramp_s: 0.3", "ramp_s: 1e-10"),
    "another axis' output": ("voltage_y, range_V", "voltage_x, range_V"),
    "empty": (None, ""),
    "cut in half": (None, None),
    "bytes that are no text": (None, "\udcff\udcfe\udc80"),
}
"""What people do to a file by mistake: what is replaced everywhere, and by what; None as the former is the whole."""


@dataclass(frozen=True)
class Step:
    """One thing that is done, and the pause after it; what lasts (a cut, a stop) goes on meanwhile."""

    kind: str
    pause_ms: int
    more: dict = field(default_factory=dict)

    def __str__(self):
        more = ", ".join(f"{key} {value}" for key, value in self.more.items())
        return f"{self.kind}{f' ({more})' if more else ''}, then {self.pause_ms} ms"


def plan(seed, number):
    """The steps of interleaving `number`, so that any one can be played again alone."""
    draw = Random(f"{seed}/{number}")
    steps = []
    if draw.random() < 0.9:
        steps.append(Step("arm", draw.choice((20, 100, 250, 400, 500, 600))))
    steps += [_drawn(draw, "share") for _ in range(draw.randint(2, 5))]
    if draw.random() < 0.16:
        steps.insert(draw.randint(1, len(steps)), _drawn(draw, "end"))
        steps += [_drawn(draw, "after") for _ in range(draw.randint(0, 3))]
    return steps


def act(bench, step):
    """Do one step, without the pause after it; a refusal is an answer, not an error."""
    bench.note(str(step))
    with suppress(ProcessLookupError):
        KINDS[step.kind].act(bench, **step.more)


def _drawn(draw, when):
    shares = {kind: getattr(each, when) for kind, each in KINDS.items()}
    kind = draw.choices([*shares], [*shares.values()])[0]
    more = {key: value(draw) for key, value in KINDS[kind].more.items()}
    return Step(kind, draw.choice((0, 0, 5, 20, 50, 100, 150, 250, 400)), more)


def _asked(bench, verb, *arguments, **more):
    """Ask the controller; whether it accepted, None where that is not known."""
    try:
        with bench.client() as client:
            getattr(client, verb)(*arguments, **more)
    except (TimeoutError, DeviceUnavailable) as problem:
        bench.note(f"{verb}: {problem}")
        return None
    except (MicromanipError, UsageError) as problem:
        bench.note(f"{verb} refused: {str(problem)[:160]}")
        if "bug" in str(problem):
            bench.wrong("crash", f"{verb} {arguments}: {problem}")
        return False
    return True


def _arm(bench):
    asked_ns = time.monotonic_ns()
    if _asked(bench, "arm") is not False:
        bench.oracle.armed(asked_ns)


def _set(bench, changes):
    if _asked(bench, "set", changes):
        bench.set_in_force(changes)


def _reload(bench):
    text = bench.config.read_bytes()
    if _asked(bench, "reload"):
        bench.file_in_force(text)


def _hang_up(bench):
    """SIGHUP: as `reload`, but whether the file was taken over is not told."""
    if bench.alive:
        text = bench.config.read_bytes()
        os.kill(bench.running.process.pid, signal.SIGHUP)
        bench.file_in_force(text)


def _spoil(bench, how):
    (old, new), text = SPOILT[how], bench.text
    if old is not None:
        assert old in text, f"{how}: {old!r} is not in the file"
        new = text.replace(old, new)
    bench.config.write_bytes((text[: len(text) // 2] if new is None else new).encode(errors="surrogateescape"))


def _cut(bench, how, ms):
    bench.port.cut(how)
    bench.later(ms, bench.port.mend)


def _for_a_while(bench, name, value, ms):
    setattr(bench.amplifier, name, value)
    bench.later(ms, lambda: setattr(bench.amplifier, name, None))


def _power(bench, ms):
    bench.amplifier.switch(False)
    bench.later(ms, lambda: bench.amplifier.switch(True))


def _rest(bench, how, reads):
    """Ask for rest, while readings fail: it must come, if the device could be written to all the time."""
    if not bench.alive:
        return
    bench.amplifier.fails = reads
    if how == "disarm":
        _asked(bench, "disarm")
    else:
        _stop(bench)
        if bench.running is not None and how == "park":
            bench.later(500, lambda: bench.park(5))
    bench.see_it_rest(f"{how} while readings are {reads}")
    bench.amplifier.fails = None


def _kill(bench, who):
    names = {"host and loop": ("host", "loop"), "all": ("host", "loop", "worker")}.get(who, (who,))
    for pid in [pid for name in names if (pid := bench.process(name)) is not None]:
        with suppress(ProcessLookupError):
            os.kill(pid, signal.SIGKILL)


def _stop(bench):
    if bench.alive:
        bench.running.process.send_signal(signal.SIGTERM)


@dataclass(frozen=True)
class Kind:
    """Of step: what it does, how often it comes before the controller ends, as its end and after it, what is drawn."""

    act: Callable
    share: int = 0
    after: int = 0
    end: int = 0
    more: dict[str, Callable] = field(default_factory=dict)


def _of(*choices):
    return lambda draw: draw.choice(choices)


def _verb(name):
    return lambda bench, **more: _asked(bench, name, **more)


def _cut_ms(draw):
    """Shorter and longer than the ramp of the cells, 300 ms."""
    return draw.choice((20, 80, 150, 300, 600, 900)) + draw.randrange(20)


def _off_ms(draw):
    return draw.choice((1, 20, 100, 300, 1000, 3000, 20000) if draw.random() < 0.2 else (1, 50, 400, 1500))


KINDS = {
    "arm": Kind(_arm, 14, 3),
    "disarm": Kind(_verb("disarm"), 7, 1),
    "hold": Kind(_verb("hold"), 5),
    "reset": Kind(_verb("reset"), 6),
    "jog by": Kind(_verb("jog"), 6, more={"axis": _of("x", "y"), "by_um": _of(-20.0, 15.0, 40.0)}),
    "jog to": Kind(_verb("jog"), 6, more={"axis": _of("x", "y"), "to_um": _of(-1e9, 25.0, 100.0)}),
    "set": Kind(_set, 8, more={"changes": _of(*GOOD_SETS)}),
    "bad set": Kind(_set, 4, more={"changes": _of(*BAD_SETS)}),
    "reload": Kind(_reload, 4),
    "hang up": Kind(_hang_up, 2),
    "spoil": Kind(_spoil, 5, 4, more={"how": _of(*SPOILT)}),
    "repair": Kind(lambda bench: bench.config.write_text(bench.text), 3, 2),
    "freeze": Kind(
        lambda bench, who, ms: bench.freeze(who, ms), 14, 3,
        more={"who": _of("loop", "worker", "worker", "host", "device"), "ms": lambda draw: draw.randrange(50, 501)},
    ),
    "cut": Kind(_cut, 14, 3, more={"how": _of(*CUTS), "ms": _cut_ms}),
    "refuse": Kind(
        lambda bench, ms: bench.cell.blind or _for_a_while(bench, "refuses", True, ms), 3,
        more={"ms": _of(30, 100, 300, 600)},
    ),
    "reads fail": Kind(
        lambda bench, how, ms: _for_a_while(bench, "fails", how, ms), 14, 3,
        more={"how": _of(*READS), "ms": _of(30, 150, 600, 2000)},
    ),
    "power": Kind(_power, 14, 4, more={"ms": _off_ms}),
    "rest": Kind(_rest, 6, more={"how": _of(*["disarm"] * 6, "stop", "park"), "reads": _of(*READS)}),
    "kill": Kind(_kill, 4, more={"who": _of("worker", "worker", "worker", "black box")}),
    "park": Kind(lambda bench, wait_s: bench.park(wait_s), 1, 6, more={"wait_s": _of(0, 0, 5)}),
    "start": Kind(lambda bench: bench.start(), after=6),
    "stop": Kind(_stop, end=4),
    "end": Kind(_kill, end=12, more={"who": _of(*["host"] * 4, *["loop"] * 4, "host and loop", *["all"] * 3)}),
}  # fmt: skip
