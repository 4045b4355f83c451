"""What happens in one interleaving: drawn from a seed and its number, so that any one can be played again alone."""

from dataclasses import asdict, dataclass, field
from random import Random

from .played.amplifier import READS
from .played.port import CUTS
from .spoilt_files import SPOILT

RAMP_MS = 300
"""start.ramp_s of the cells: cuts are shorter and longer than that."""
GOOD_SETS = (
    {"axes.x.inner.K_V_per_um": 0.06},
    {"axes.x.setpoint.slew_um_per_ms": 0.3},
    {"axes.y.authority_percent": 60.0},
    {"faults.link.loop_silent_ms": 40.0},
    {"faults.link.silent_ms": 150.0},
    {"start.ramp_s": 0.25},
    {"start.lift_s": 0.2},
    {"outputs.voltage_x.range_V": [-10, 90]},
    {"outputs.voltage_y.slew_V_per_ms": 0.4},
    {"outputs.voltage_x.range_V": [-10, 70], "outputs.voltage_y.range_V": [0, 80]},
    {"axes.x.mode": "voltage"},
    {"axes.y.centre_um": 50.0},
    {"reference.offset_um": 40.0},
    {"faults.axis.following_error.limit_um": 500.0},
)
"""Some are refused while an axis tracks."""
BAD_SETS = (
    {"outputs.voltage_x.range_V": [100, -20]},
    {"outputs.voltage_x.range_V": [-20, 1e300]},
    {"outputs.voltage_x.park_V": 50.0},
    {"outputs.voltage_y.slew_V_per_ms": 0.0},
    {"start.ramp_s": 1e300},
    {"start.ramp_s": -1.0},
    {"axes.x.inner.K_V_per_um": "fast"},
    {"axes.x.inner": None},
    {"axes.z.mode": "strain"},
    {"faults.link.silent_ms": 1e300},
    {"reference.range_um": [110, 20]},
    {"loop.rate_hz": 5000},
    {"": 1},
)
_OFTEN = {
    "arm": 14,
    "disarm": 7,
    "hold": 5,
    "reset": 6,
    "jog": 12,
    "reload": 4,
    "hang up": 2,
    "set": 8,
    "bad set": 4,
    "garbage": 3,
    "spoil": 5,
    "repair": 3,
    "freeze": 14,
    "cut": 14,
    "refuse": 3,
    "reads fail": 14,
    "power": 14,
    "rest": 6,
    "kill": 4,
    "park": 1,
}
"""How often each kind of step comes, in shares."""
_AFTERMATH = {
    "park": 6,
    "start": 6,
    "power": 4,
    "spoil": 4,
    "repair": 2,
    "cut": 3,
    "freeze": 3,
    "reads fail": 3,
    "arm": 3,
    "disarm": 1,
}
"""After a step that ends the controller."""
_ENDS = {"host": 4, "loop": 4, "host and loop": 1, "all": 3, "stop": 4}
_END_SHARE = 0.16
_ARMED_SHARE = 0.9


@dataclass(frozen=True)
class Step:
    """One thing that is done, and the pause after it; what lasts (a cut, a stop) goes on meanwhile."""

    kind: str
    pause_ms: int
    more: dict = field(default_factory=dict)

    def __str__(self):
        more = ", ".join(f"{key} {value}" for key, value in self.more.items())
        return f"{self.kind}{f' ({more})' if more else ''}, then {self.pause_ms} ms"

    def document(self):
        return asdict(self)


def plan(seed, number):
    """The steps of interleaving `number`."""
    draw = Random(f"{seed}/{number}")
    steps = []
    if draw.random() < _ARMED_SHARE:
        steps.append(Step("arm", draw.choice((20, 100, 250, 400, 500, 600))))
    steps += [_step(draw, _kind(draw, _OFTEN)) for _ in range(draw.randint(2, 5))]
    if draw.random() < _END_SHARE:
        steps.insert(draw.randint(1, len(steps)), _end(draw))
        steps += [_step(draw, _kind(draw, _AFTERMATH)) for _ in range(draw.randint(0, 3))]
    return steps


def _kind(draw, shares):
    return draw.choices([*shares], [*shares.values()])[0]


def _end(draw):
    how = _kind(draw, _ENDS)
    return Step("stop" if how == "stop" else "kill", _pause_ms(draw), {} if how == "stop" else {"who": how})


def _step(draw, kind):
    return Step(kind, _pause_ms(draw), _more(draw, kind))


def _pause_ms(draw):
    return draw.choice((0, 0, 5, 20, 50, 100, 150, 250, 400))


def _more(draw, kind):
    match kind:
        case "jog":
            far = draw.choice(
                ({"by_um": draw.choice((-20.0, 15.0, 40.0))}, {"to_um": draw.choice((-1e9, 25.0, 100.0))})
            )
            return {"axis": draw.choice("xy"), **far}
        case "set":
            return {"changes": draw.choice(GOOD_SETS)}
        case "bad set":
            return {"changes": draw.choice(BAD_SETS)}
        case "garbage":
            return {"seed": draw.randrange(10**6)}
        case "spoil":
            return {"how": draw.choice([*SPOILT])}
        case "freeze":
            return {"who": draw.choice(("loop", "worker", "worker", "host", "device")), "ms": draw.randrange(50, 501)}
        case "cut":
            lasts_ms = draw.choice((20, 80, RAMP_MS // 2, RAMP_MS, 2 * RAMP_MS, 3 * RAMP_MS))
            return {"how": draw.choice(CUTS), "ms": lasts_ms + draw.randrange(20)}
        case "power":
            return {
                "ms": draw.choice((1, 20, 100, 300, 1000, 3000, 20000) if draw.random() < 0.2 else (1, 50, 400, 1500))
            }
        case "reads fail":
            return {"how": draw.choice(READS), "ms": draw.choice((30, 150, 600, 2000))}
        case "rest":
            return {"how": draw.choice((*["disarm"] * 6, "stop", "park")), "reads": draw.choice(READS)}
        case "refuse":
            return {"ms": draw.choice((30, 100, 300, 600))}
        case "kill":
            return {"who": draw.choice(("worker", "worker", "worker", "recorder", "black box"))}
        case "park":
            return {"wait_s": draw.choice((0, 0, 5))}
        case _:
            return {}
