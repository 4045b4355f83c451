"""What a configuration and its EDS files may say, and what is said of those that can't work."""

import re
import shutil

import canopen
import pytest
from canopen.objectdictionary import ODVariable, import_od
from micromanip_drivers.canbus.plan import PackPlan, UnpackPlan
from micromanip_drivers.canopen.dictionary import Dictionary
from micromanip_drivers.canopen.driver import CanOpen
from pydantic import ValidationError

from micromanip.driver import Watchdog
from micromanip.errors import ConfigError

from ..changed_options import DELETE
from .cell import CONFIG, EDS, driver, options


def refused(match, folder=CONFIG, **changes):
    with pytest.raises(ConfigError, match=match):
        driver(folder, **changes)


@pytest.fixture
def folder(tmp_path):
    shutil.copytree(EDS, tmp_path / "can")
    return tmp_path


def edit(folder, name, pattern, replacement):
    file = folder / "can" / f"{name}.eds"
    text, count = re.subn(pattern, replacement, file.read_text(), flags=re.DOTALL)
    assert count == 1
    file.write_text(text)


def section(folder, name, head, key, value):
    edit(folder, name, rf"(\[{head}\]\n[^\[]*?{key}=)[^\n]*", rf"\g<1>{value}")


def test_layout_is_the_librarys():
    """Where the driver looks for a value is where the library's own PDO has put it."""
    objects = import_od(str(EDS / "sensor.eds"), 5)
    theirs = canopen.LocalNode(5, objects).tpdo
    theirs.network = canopen.Network()
    ours = driver()._nodes[0].tpdos
    for number in (1, 2, 3):
        theirs[number].read(from_od=True)
        for raw, wire, variable in zip((-(1 << 23), 1234567), ours[number - 1].wires, theirs[number], strict=True):
            variable.raw = raw
            data = bytes(theirs[number].data)
            assert UnpackPlan([wire]).values(data) == pytest.approx([raw * 1e-4], abs=1e-9)
            written = int.from_bytes(PackPlan([wire], len(data)).data([raw * 1e-4]), "little")
            assert int.from_bytes(data, "little") >> wire.shift & wire.mask == written >> wire.shift
        assert ours[number - 1].mapping.length == len(theirs[number].data)


def test_load_is_that_of_the_packed_line():
    """1 kHz with SYNC, three TPDOs and an RPDO of 6 bytes: 515 us a cycle, and the heartbeats besides."""
    changes = {f"nodes__sensor__tpdo__{i}__rate_hz": 1000.0 for i in (1, 2, 3)}
    bus = driver(sync_hz=1000.0, nodes__amplifier__rpdo__1__rate_hz=1000.0, **changes)
    (load,) = bus.loads()
    heartbeats = 2 * 12.5 * 65e-6  # a byte, 65 bits, three times in 240 ms
    assert load.share == pytest.approx(0.515 + heartbeats)
    frames, _, served = load.detail.partition("; ")
    assert frames == "1000 SYNC x 55 us + 3000 TPDO x 115 us + 1000 RPDO x 115 us + 25 heartbeat x 65 us"
    assert served == "polled, stamped by the test bus"
    latencies = [channel.latency_s * 1e6 for channel in bus.inputs]
    # SYNC 55, then by identifier 0x185, 0x206 (the RPDO), 0x285, 0x385 at 115 each, up to its own; before all that the
    # longest of lower priority, which had the bus already: a PDO for the first two, a heartbeat of 65 for the last
    assert latencies == pytest.approx([285, 285, 515, 515, 580, 580])
    assert [channel.latency_s * 1e6 for channel in bus.outputs] == pytest.approx([55 + 2 * 115 + 115] * 3)


@pytest.mark.parametrize(
    ("pattern", "written", "line", "said"),
    [
        (r"\Z", "[2100]\nParameterName\n", 706, "'ParameterName' in [2100] is no KEY=VALUE"),
        (r"\Z", "[2100Sub1]\nParameterName=a\n", 705, "[2100sub1] belongs to [2100], which is not there"),
        (r"AccessType=ro\n", "", 74, "[1000] has no AccessType"),
        (r"DataType=0x0007\n", "DataType=0xUNSIGNED\n", 77, "DataType '0xUNSIGNED' in [1000] is no number"),
    ],
)
def test_what_is_wrong_in_an_eds_is_told_with_its_line(tmp_path, pattern, written, line, said):
    file = tmp_path / "sensor.eds"
    file.write_text(re.sub(pattern, written, (EDS / "sensor.eds").read_text(), count=1))
    with pytest.raises(ConfigError, match=re.escape(f"{file}:{line}: {said}")):
        Dictionary(file, 5)


def of_other_programs(text):
    """The file of the example as other programs would have saved it."""
    yield re.sub(r"(?m)^(\w+=|\[.*\])", lambda each: each[0].upper(), text).encode()
    yield re.sub(r"(?m)^(\w+)=(.*)$", r"  \1 = \2  ; note", text).encode()
    yield (text.replace("\n", "\r\n") + "\x1a").encode("utf-8-sig")
    yield text.encode("utf-16")
    yield text.replace("VendorName=micromanip", "VendorName=Müller Meßtechnik").encode("latin-1")
    yield re.sub(r"DefaultValue=(0x\w+|\d+)", lambda v: f"DefaultValue=0{int(v[1], 0):o}", text).encode()


@pytest.mark.parametrize("program", range(6))
def test_an_eds_of_another_program_says_the_same(tmp_path, program):
    def objects(data):
        (tmp_path / "sensor.eds").write_bytes(data)
        found = Dictionary(tmp_path / "sensor.eds", 5).objects
        return [
            (v.index, v.subindex, v.name, v.data_type, v.access_type, v.pdo_mappable, v.default)
            for entry in found.values()
            for v in ([entry] if isinstance(entry, ODVariable) else entry.subindices.values())
            if v.index >= 0x1000
        ]

    text = (EDS / "sensor.eds").read_text()
    same = objects(text.encode())
    assert len(same) > 60
    assert objects(list(of_other_programs(text))[program]) == same


def test_a_value_that_is_no_number_is_told_and_not_replaced_by_the_default(folder):
    section(folder, "sensor", "1A00sub1", "DefaultValue", "0x81300118\nParameterValue=81300318h")
    refused(r"object 1A00sub1 \(Mapped object 1\): ParameterValue '81300318h' is no number", folder)
    section(folder, "sensor", "1A00sub1", "ParameterValue", "")
    driver(folder)
    section(folder, "sensor", "1A00sub1", "DefaultValue", "$NODE+1")
    refused(r"object 1A00sub1 \(Mapped object 1\): DefaultValue '\$NODE\+1' is no number", folder)


def test_a_domain_may_leave_out_what_all_domains_are(tmp_path):
    """CiA 306: an object of the kind DOMAIN is of that type too, and may be read and written."""
    text = (EDS / "sensor.eds").read_text() + "\n[2100]\nParameterName=Program\nObjectType=0x2\n"
    (tmp_path / "sensor.eds").write_text(text)
    variable = Dictionary(tmp_path / "sensor.eds", 5).variable(0x2100)
    assert (variable.data_type, variable.access_type) == (0xF, "rw")


def rpdo(*mapped):
    """An rpdo of the amplifier with a mapping of its own."""
    pdo = {"rate_hz": 200, "map": list(mapped), "signals": {"a": {"object": mapped[0], "scale": 1.0}}}
    return {"nodes__amplifier__rpdo": {1: pdo}}


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"nodes__sensor__eds": "can/nothing.eds"}, r"^nodes\.sensor\.eds: EDS file .* can't be read: No such file"),
        (rpdo("1010sub1"), r"1010sub1 \(Save all parameters\) is not written cyclically: it would store parameters"),
        (rpdo("1017"), "1017sub0 .* is not written cyclically: it is no process data"),
        (rpdo("error_value_x"), r"6444sub1 \(error_value_x\) can't be in a PDO"),
        (rpdo("stage_q"), "has no object called stage_q"),
        (
            {"nodes__amplifier__rpdo__1__signals": {"voltage_x": {"scale": 0.005}}},
            r"rpdo 1 carries voltage_y, voltage_z too, which signals does not name",
        ),
        (
            {"nodes__sensor__tpdo__2__signals": {"strain_x": {"object": "strain_y", "scale": 1.0}}},
            "nodes.sensor.tpdo.2.signals.strain_x: it is in tpdo 1 too",
        ),
    ],
)
def test_a_mapping_that_makes_no_sense_is_refused(changes, said):
    refused(said, **changes)


@pytest.mark.parametrize(
    ("name", "head", "value", "said"),
    [
        ("sensor", "1A00sub2", "0x81300308", r"8130sub3 \(strain_y\) is mapped with 8 bits, its data type has 24"),
        ("amplifier", "1400sub1", "$NODEID+0x17F", "amplifier and tpdo 1 of node sensor are both on identifier 0x185"),
        ("amplifier", "1400sub1", "0x80", "1400sub1 is 0x80, which is no identifier of a PDO"),
        ("amplifier", "1400sub1", "$NODEID+0x80000200", "has rpdo 1 switched off: give it a map"),
    ],
)
def test_an_eds_that_maps_no_pdo_is_refused(folder, name, head, value, said):
    section(folder, name, head, "DefaultValue", value)
    refused(said, folder)


def test_watchdog(folder):
    assert driver(nodes__amplifier__watchdog_ms=DELETE).watchdog is None
    by_other_means = driver(
        nodes__amplifier__watchdog_ms=DELETE, nodes__amplifier__watchdog={"ms": 50, "after_power_on": "rest"}
    )
    assert by_other_means.watchdog == "amplifier at rest 0 ms after 50 ms of silence"
    edit(folder, "amplifier", r"\[1400sub5\].*?\n\n", "")
    refused(r"has no 1400sub5, so it can't wait for that rpdo; watchdog_by: heartbeat is possible", folder)
    edit(folder, "amplifier", r"\[1016sub1\].*?\n\n", "")
    refused("has no 1016sub1, so it can't wait for a heartbeat", folder, nodes__amplifier__watchdog_by="heartbeat")


@pytest.mark.parametrize(
    ("changes", "match"),
    [
        ({"bitrate": 2_000_000}, "CANopen is classic CAN"),
        ({"nodes__sensor__watchdog_ms": 20}, "this node has no rpdo"),
        ({"nodes__sensor__tpdo": {}}, "a node needs a tpdo or an rpdo"),
        ({"own_node_id": 5}, r"nodes\.sensor\.node_id: 5 is also that of own_node_id"),
        ({"nodes__amplifier__watchdog": {"ms": 20, "after_power_on": "rest"}}, "leave it or watchdog_ms out"),
    ],
)
def test_keys_that_are_refused(changes, match):
    with pytest.raises(ValidationError, match=match):
        CanOpen.Options.model_validate(options(**changes))


def test_a_node_that_waits_for_outputs_goes_to_rest_without_them_as_on_any_bus():
    """So what it was given before a worker that stood still is not what it has after."""
    assert driver().silence == Watchdog(ms=200, after_power_on="unknown")
    assert driver(nodes__amplifier__watchdog_by="heartbeat").silence is None
    own = Watchdog(ms=50, after_power_on="rest")
    assert driver(nodes__amplifier__watchdog_ms=DELETE, nodes__amplifier__watchdog=own.model_dump()).silence == own
    assert driver(nodes__amplifier__watchdog_ms=60_000).silence is None
