"""What the keys of `ethercat` refuse, and the frame that they make."""

from copy import deepcopy

import pytest
from micromanip_drivers.ethercat.driver import Ethercat
from micromanip_drivers.ethercat.image import Image
from pydantic import ValidationError

from micromanip.bus.ethercat.frames import unframed
from micromanip.bus.ethercat.registers import AL_STATUS, ARMW, BRD, DC_SYSTEM, LRW, NOP
from micromanip.errors import ConfigError

from .bench import AMPLIFIER, GAUGE, PERIOD_NS, PINS_OUT, options


def test_a_frame_holds_count_image_states_and_time():
    image = Image(options())
    datagrams = list(unframed(image.frame))
    assert [(d.command, d.address, len(d.data)) for d in datagrams] == [
        (NOP, (0, 0), 4),
        (LRW, 0, 5 + 1 + 9),
        (BRD, (0, AL_STATUS), 2),
        (ARMW, (0, DC_SYSTEM), 8),
    ]
    assert image.working_counter == 3 + 1
    assert (image.placed["gauge"].inputs_at, image.placed["gauge"].input_bytes) == (6, 9)


def without(keys, *path):
    """The keys but for one."""
    first, *rest = path
    return {k: without(v, *rest) if k == first and rest else v for k, v in keys.items() if k != first or rest}


def changed_field(keys, direction, pdo, field, **changes):
    """The keys of a terminal with some of a field changed."""
    keys = deepcopy(keys)
    keys[direction][pdo]["fields"][field] |= changes
    return keys


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"terminals": {"gauge": without(GAUGE, "inputs", "tracker", "rate_hz")}}, "counter and rate_hz belong"),
        (
            {"terminals": {"a": AMPLIFIER | {"settings": {"range": {"index": 1, "type": "uint8", "value": 256}}}}},
            "256 does not fit into uint8",
        ),
        (
            {"terminals": {"pins": changed_field(PINS_OUT, "outputs", "channel_3", "lamp", safe=1)}},
            "channel_3.fields.lamp: safe 1 is a line that is on, and a terminal without frames switches it off",
        ),
    ],
)
def test_keys_that_make_no_sense_are_refused(changes, said):
    with pytest.raises(ValidationError, match=said):
        options(**changes)


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"watchdog": None}, "watchdog must be given"),
        ({"silence_ms": 600}, "silence_ms: 600 ms must be at most half of the watchdog's 1000 ms"),
        ({"cyclic_safe": False}, "cyclic_safe: 10000 writes per second"),
        ({"terminals": {"gauge": GAUGE, "other": GAUGE}}, "terminals.other.inputs: count is a field of gauge too"),
    ],
)
def test_what_only_the_driver_knows_is_refused(changes, said):
    with pytest.raises(ConfigError, match=said):
        Ethercat(options(**changes), PERIOD_NS)
