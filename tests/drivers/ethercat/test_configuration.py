"""What the keys of `ethercat` refuse, and the frame that they make."""

from copy import deepcopy

import pytest
from micromanip_drivers.ethercat.driver import Ethercat
from micromanip_drivers.ethercat.image import Image
from pydantic import ValidationError

from campaigns.fault_cells import drive_cell
from micromanip.bus.ethercat.frames import unframed
from micromanip.bus.ethercat.registers import AL_STATUS, ARMW, BRD, DC_SYSTEM, LRW, NOP
from micromanip.errors import ConfigError
from micromanip.settings.check import prepare

from .bench import AMPLIFIER, GAUGE, PERIOD_NS, PINS_OUT, options
from .drive_bench import DRIVE, drive


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


def with_fields(direction, change):
    """The drive whose fields of one direction are changed by a function."""
    name, pdo = next(iter(DRIVE[direction].items()))
    return DRIVE | {direction: {name: pdo | {"fields": change(dict(pdo["fields"]))}}}


def lacking(name):
    return lambda fields: {each: keys for each, keys in fields.items() if each != name}


@pytest.mark.parametrize(
    ("terminal", "said"),
    [
        (with_fields("outputs", lacking("controlword")), "outputs must map 0x6040:00, controlword, once and as uint16"),
        (with_fields("inputs", lacking("position")), "inputs must map 0x6064:00, position actual value, once and as"),
        (with_fields("inputs", lacking("error_code")), "inputs must map 0x603f:00, error code"),
        (drive(take_up_V_per_s=None), "take_up_V_per_s: must be given with mode csp, and only there"),
        (drive(reset="amplifier_enable"), "reset: must be another channel than enable"),
    ],
)
def test_a_drive_that_lacks_what_it_needs_is_refused(terminal, said):
    with pytest.raises(ValidationError, match=said):
        options(terminals={"stage": terminal})


def test_a_cell_waits_for_longer_than_its_drives_take_to_come_on(tmp_path):
    """Or the drive would still be on its way when the start gives up; also where neither key is written down."""
    file, key = tmp_path / "cell.yaml", "drivers.cell.terminals.amplifier.drive"

    def refused(old, new):
        file.write_text(drive_cell().replace(old, new))
        with pytest.raises(ConfigError) as found:
            prepare(file)
        return str(found.value)

    both = "enable_ms is 300 ms, start.enable_s 0.3 s: "
    line = drive_cell().splitlines().index("          enable_ms: 250") + 1
    assert refused("enable_ms: 250", "enable_ms: 300").startswith(f"{file}:{line}: {key}.enable_ms: {both}")
    assert f"{key}.enable_ms: enable_ms is 500 ms" in refused("          enable_ms: 250\n", "")
    assert "start.enable_s longer than 0.25 s, or enable_ms less than 100 ms" in refused("enable_s: 0.3, ", "")
    unbound = refused(", amplifier_enable: {driver: cell, channel: amplifier_enable}", "")
    assert f"{key}: no switch writes channel amplifier_enable" in unbound
    file.write_text(drive_cell())
    prepare(file)
