"""What the driver makes of options and frames; and what it says of options that make no sense."""

import re

import can
import cantools
import pytest
from micromanip_drivers.canbus.database import Database, switches_bitrate
from micromanip_drivers.canbus.driver import CanBus, CanBusOptions
from pydantic import ValidationError

from campaigns.report import CONFIG
from micromanip.bus.errors import DeviceFault
from micromanip.bus.inbox import Inbox
from micromanip.emulation.can.canbus import DbcMessage
from micromanip.errors import ConfigError

DATABASE = cantools.database.load_file(CONFIG / "can/manipulator.dbc")
SENSORS = DATABASE.get_message_by_name("Sensors")
REST = dict.fromkeys((signal.name for signal in SENSORS.signals), 0)


def options(database="can/manipulator.dbc", **keys):
    given = {
        "interface": "virtual",
        "channel": "canbus",
        "bitrate": 1_000_000,
        "data_bitrate": 5_000_000,
        "silence_ms": None,
        "receive": {"Sensors": {"rate_hz": 2000.0, "counter": "Count", "status": {"signal": "Status"}}},
        "send": {"Voltages": {"rate_hz": 2000.0, "counter": "Count"}},
    }
    return CanBusOptions(database=str(database), **(given | keys))


@pytest.fixture
def bus():
    bus = CanBus(options(), CONFIG)
    bus.open()
    yield bus
    bus.close()


@pytest.fixture
def peer():
    with can.Bus("canbus", "virtual", protocol=can.CanProtocol.CAN_FD) as peer:
        yield peer


def send(peer, identifier=0x101, extended=False, **values):
    data = SENSORS.encode(REST | values)
    peer.send(can.Message(arbitration_id=identifier, data=data, is_fd=True, is_extended_id=extended))


def samples(bus):
    inbox = Inbox()
    bus.receive(inbox, 0)
    return [sample for sample in inbox if bus.inputs[sample.channel].name == "Sensors.strain_x"]


def test_a_status_of_zero_can_be_bad(peer):
    status = {"signal": "Status", "good": [1, 3]}
    bus = CanBus(options(receive={"Sensors": {"rate_hz": 1.0, "status": status}}), CONFIG)
    bus.open()
    for value in (0, 1, 2, 3):
        send(peer, Status=value)
    assert [sample.status for sample in samples(bus)] == [-1, 0, 2, 0]
    bus.close()


def test_a_second_controller_is_a_fault(bus, peer):
    bus.perform(0, [0.0] * 6, Inbox())
    bus.receive(Inbox(), 0)  # our own frames are none of it
    peer.send(can.Message(arbitration_id=0x100, data=bytes(8), is_extended_id=False, is_fd=True))
    with pytest.raises(DeviceFault, match="somebody else sends Voltages on virtual-canbus"):
        bus.receive(Inbox(), 0)


DBC = """VERSION ""
NS_ :
BS_:
BU_: A
BO_ 1 Plain: 8 A
 SG_ value : 0|16@1+ (1,0) [0|0] "" A
 SG_ count : 16|8@1- (1,0) [0|0] "" A
BO_ 2 Muxed: 8 A
 SG_ which M : 0|8@1+ (1,0) [0|0] "" A
 SG_ one m0 : 8|8@1+ (1,0) [0|0] "" A
BO_ 3 Long: 24 A
 SG_ value : 0|16@1+ (1,0) [0|0] "" A
BO_ 4 Twin: 8 A
 SG_ value : 0|16@1+ (1,0) [0|0] "" A
BO_ 4 Twin2: 8 A
 SG_ value : 0|16@1+ (1,0) [0|0] "" A
BO_ 5 Counter: 8 A
 SG_ only : 0|8@1+ (1,0) [0|0] "" A
BO_ 6 NoRest: 8 A
 SG_ value : 0|8@1+ (1,10) [10|20] "" A
BO_ 2147483655 Extended: 8 A
 SG_ value : 0|16@1+ (1,0) [0|0] "" A
"""


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "test.dbc").write_text(DBC)
    return tmp_path


@pytest.mark.parametrize(
    ("keys", "words"),
    [
        ({"receive": {"plain": {"rate_hz": 1.0}}}, "receive.plain: test.dbc has no message plain; did you mean Plain?"),
        (
            {"receive": {"Plain": {"rate_hz": 1.0, "counter": "count"}}},
            "receive.Plain.counter: Plain.count must be unsigned, with scale 1 and offset 0",
        ),
        ({"receive": {"Muxed": {"rate_hz": 1.0}}}, "receive.Muxed: Muxed is multiplexed"),
        (
            {"receive": {"Long": {"rate_hz": 1.0}}},
            "Long has 24 bytes, which classic CAN has not: for CAN FD give it VFrame",
        ),
        ({"receive": {"Twin": {"rate_hz": 1.0}}}, "Twin and Twin2 both have the identifier 0x4 in test.dbc"),
        (
            {"receive": {"Plain": {"rate_hz": 1.0}}, "send": {"Plain": {"rate_hz": 1.0}}},
            "send.Plain: Plain is received",
        ),
        ({"send": {"NoRest": {"rate_hz": 1.0}}}, "send.NoRest: value is 0, it may be 10 to 20"),
        ({}, "receive or send: at least one message must be given"),
    ],
)
def test_messages_that_can_not_be(folder, keys, words):
    with pytest.raises(ConfigError, match=re.escape(words)):
        CanBus(options("test.dbc", **({"receive": {}, "send": {}} | keys)), folder)


def test_a_silence_must_be_longer_than_the_device_is_silent_anyway():
    with pytest.raises(ValidationError, match=r"silence_ms 100 is less than three periods .* \(20 Hz\).* or null"):
        options(silence_ms=100, receive={"Sensors": {"rate_hz": 20.0}, "Tracker": {"rate_hz": 2.0}})
    options(silence_ms=150, receive={"Sensors": {"rate_hz": 20.0}, "Tracker": {"rate_hz": 2.0}})


WIDE = DBC.replace("BO_ 1 Plain: 8", "BO_ 1 Plain: 16").replace("count : 16", "count : 96")
NONSENSE = [
    (DBC.replace("value : 0|16@1+ (1,0)", "value : 0|16@1+ (0,0)", 1), "value has scale 0 and offset 0"),
    (WIDE.replace("value : 0|16", "value : 0|80", 1), "value has 80 bits, more than 64"),
    (DBC.replace("16|8@1-", "8|8@1-"), "overlapping"),
]


@pytest.mark.parametrize(("text", "words"), NONSENSE, ids=[words for _, words in NONSENSE])
def test_a_message_that_makes_no_sense_is_refused_where_it_is_used(tmp_path, text, words):
    """A file of a whole machine has messages that nobody here cares for."""
    assert text not in (DBC, WIDE)
    (tmp_path / "test.dbc").write_text(text)
    with pytest.raises(ConfigError, match=rf"^database: .*test.dbc:5: it makes no sense: .*{words}.* in message Plain"):
        CanBus(options("test.dbc", receive={"Plain": {"rate_hz": 1.0}}, send={}), tmp_path)
    CanBus(options("test.dbc", receive={"Counter": {"rate_hz": 1.0}}, send={}), tmp_path)


ATTRIBUTES = """
BA_DEF_ BO_ "VFrameFormat" ENUM "a","b","c","d","e","f","g","h","i","j","k","l","m","n",
 "StandardCAN_FD","ExtendedCAN_FD";
BA_DEF_ BO_ "CANFD_BRS" ENUM "0","1";
BA_DEF_ SG_ "GenSigStartValue" FLOAT 0 100000;
BA_DEF_DEF_ "VFrameFormat" "StandardCAN_FD";
BA_DEF_DEF_ "CANFD_BRS" "0";
BA_DEF_DEF_ "GenSigStartValue" 20;
"""
"""What an editor writes: defaults, and of a message or a signal only what differs from them."""


@pytest.mark.parametrize(("own", "switches"), [("", False), ('BA_ "CANFD_BRS" BO_ 1 1;\n', True)])
def test_what_a_message_does_not_say_is_the_files_default(tmp_path, own, switches):
    (tmp_path / "test.dbc").write_text(DBC + ATTRIBUTES + own)
    message = Database(tmp_path / "test.dbc").message("send.Plain", "Plain")
    assert (message.is_fd, switches_bitrate(message)) == (True, switches)
    device = DbcMessage(message, counter=None)
    assert device.frame({"value": 0, "count": 0}, 0).bitrate_switch == switches


@pytest.mark.parametrize(
    ("said", "rest"),
    [
        (DBC, 0.0),
        (DBC + ATTRIBUTES, 20.0),
        (DBC + ATTRIBUTES + 'BA_ "GenSigStartValue" SG_ 1 value 3;\n', 3.0),
        (DBC + ATTRIBUTES + 'BA_ "GenSigStartValue" SG_ 1 value 3;\nVAL_ 1 value 0 "off" 3 "slow" ;\n', 3.0),
        (DBC + ATTRIBUTES.replace('StartValue" 20', 'StartValue" 0').replace("0|16@1+ (1,0)", "0|16@1+ (1,9)"), 0.0),
    ],
    ids=["none", "default", "own", "named", "a default that nobody chose"],
)
def test_an_output_rests_at_its_start_value(tmp_path, said, rest):
    (tmp_path / "test.dbc").write_text(said)
    bus = CanBus(options("test.dbc", receive={}, send={"Plain": {"rate_hz": 1.0}}), tmp_path)
    assert bus.outputs[0].safe == rest


FOREIGN = DBC + 'CM_ "Dehnungsmeßstreifen, µm";\n'


@pytest.mark.parametrize(
    "saved",
    [
        FOREIGN.encode("utf-8"),
        FOREIGN.encode("utf-8-sig"),
        FOREIGN.encode("utf-16"),
        FOREIGN.encode("cp1252"),
        FOREIGN.replace("\n", "\r\n").encode("cp1252") + b"\x1a",
        cantools.database.load_string(FOREIGN, "dbc").as_dbc_string().encode("cp1252"),
    ],
    ids=["utf-8", "bom", "utf-16", "windows", "dos", "cantools"],
)
def test_a_file_as_another_program_saves_it(tmp_path, saved):
    def messages():
        found = Database(tmp_path / "any.dbc").by_identifier()
        return {key: (m.name, m.length, [(s.name, s.start, s.scale) for s in m.signals]) for key, m in found.items()}

    (tmp_path / "any.dbc").write_text(DBC)
    plain = messages()
    assert plain
    (tmp_path / "any.dbc").write_bytes(saved)
    assert messages() == plain
