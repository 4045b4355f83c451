"""ESI files: what is read of them, and that no file, however spoilt, does worse than one message with its place."""

import random
import re

import pytest

from campaigns.report import CONFIG
from micromanip.bus.ethercat.esi import esi_products, read_esi
from micromanip.bus.ethercat.esi_keys import lines_of, not_mapped, terminal_keys
from micromanip.errors import ConfigError

SAMPLE = CONFIG / "ethercat" / "piezo-cell.xml"
ONE = """\
<EtherCATInfo><Vendor><Id>17229</Id></Vendor><Descriptions><Devices>
<Device>
<Type ProductCode="4099" RevisionNo="#X2">AMP</Type>
<RxPdo Sm="2">
<Index>#x1600</Index><Name>Out</Name><Exclude>#x1601</Exclude>
<Entry><Index>#x7000</Index><SubIndex>1</SubIndex><BitLen>16</BitLen><Name>Aim</Name><DataType>INT</DataType></Entry>
<Entry><Index>#x0</Index><BitLen>8</BitLen></Entry>
<Entry><Index>#x7000</Index><SubIndex>2</SubIndex><BitLen>1</BitLen><Name>On</Name><DataType>BOOL</DataType></Entry>
</RxPdo>
<TxPdo Mandatory="true"><Index>#x1A00</Index></TxPdo>
</Device></Devices></Descriptions></EtherCATInfo>
"""
MUTANTS = 300


def read(tmp_path, text):
    file = tmp_path / "device.xml"
    file.write_bytes(text if isinstance(text, bytes) else text.encode())
    return read_esi(file)


def test_the_sample_is_read_whole():
    amplifier, gauge, capacitive, tracker = read_esi(SAMPLE)
    assert [(each.vendor, each.product, each.revision) for each in (amplifier, gauge, capacitive, tracker)] == [
        (0x4D4D, product, 1) for product in (0x1003, 0x1004, 0x1005, 0x1006)
    ]
    assert amplifier.name == "Piezo amplifier"
    assert [pdo.index for pdo in amplifier.outputs] == [0x1600, 0x1601]
    assert [entry.mapping for entry in amplifier.outputs[0].entries] == [0x70000120, 0x70000220, 0x70000320]
    assert [(each.kind, each.start, each.control) for each in amplifier.sync_managers] == [
        ("MBoxOut", 0x1000, 0x26),
        ("MBoxIn", 0x1080, 0x22),
        ("Outputs", 0x1100, 0x64),
        ("Inputs", 0x1800, 0x20),
    ]
    assert (amplifier.has_coe, amplifier.maps, gauge.has_clock) == (True, True, True)
    assert [pdo.fixed for device in (gauge, tracker) for pdo in device.inputs] == [True, False]


def test_numbers_lines_and_what_is_left_out(tmp_path):
    (device,) = read(tmp_path, ONE)
    assert (device.vendor, device.product, device.revision, device.name) == (17229, 4099, 2, "AMP")
    (output,), (unassigned,) = device.outputs, device.inputs
    assert (output.sync_manager, output.excludes, output.line) == (2, {0x1601}, 4)
    assert [(entry.index, entry.subindex, entry.bits, entry.line) for entry in output.entries] == [
        (0x7000, 1, 16, 6),
        (0, 0, 8, 7),
        (0x7000, 2, 1, 8),
    ]
    assert (unassigned.sync_manager, unassigned.mandatory, unassigned.entries) == (None, True, [])
    assert (device.has_coe, device.has_clock) == (False, False)


def test_a_device_becomes_keys(tmp_path):
    (device,) = read(tmp_path, ONE)
    name, keys = terminal_keys(device, {"gap"})
    assert (name, list(keys)) == ("amp", ["vendor", "product", "revision", "outputs"]), "the input is not assigned"
    assert keys["outputs"]["out"]["fields"] == {
        "aim": {"index": 0x7000, "subindex": 1, "type": "int16"},
        "gap_2": {"index": 0, "subindex": 0, "type": "uint8"},
        "on": {"index": 0x7000, "subindex": 2, "type": "bool"},
    }
    assert list(not_mapped(device)) == []
    assert "        aim: {index: 0x7000, subindex: 1, type: int16}" in lines_of(name, keys)


@pytest.mark.parametrize(
    ("old", "new", "line", "said"),
    [
        ("<Index>#x1600", "<Index>#x1g00", 5, "Index '#x1g00' is no number from 0 to 65535"),
        ("<Index>#x1600", "<Index>-1", 5, "Index '-1' is no number"),
        ("<BitLen>16", "<BitLen>70000", 6, "BitLen '70000' is no number from 0 to 65535"),
        ("<BitLen>8</BitLen>", "", 7, "<Entry> has no <BitLen>"),
        (' ProductCode="4099"', "", 3, "<Type> of AMP has no ProductCode"),
        ('<Type ProductCode="4099" RevisionNo="#X2">AMP</Type>', "", 2, "<Device> has no <Type>"),
        ("<Id>17229</Id>", "", 1, "<Vendor> has no <Id>"),
        ("</TxPdo>", "", 11, "this is no XML: mismatched tag"),
        ("Device>", "Devise>", 1, "there is no <Device> in <Descriptions> <Devices>"),
        ("EtherCATInfo>", "Other>", 1, "<Other> is no ESI file"),
        ("<EtherCATInfo>", '<!DOCTYPE a [<!ENTITY b "c">]><EtherCATInfo>', 1, "a document type (<!DOCTYPE) is refused"),
        ("<EtherCATInfo>", '<?xml version="1.0" encoding="klingon"?><EtherCATInfo>', 1, "can't be read|this is no XML"),
        ("AMP", "<a>" * 200 + "</a>" * 200, 3, "more than 100 deep"),
    ],
)
def test_what_is_wrong_is_told_with_its_line(tmp_path, old, new, line, said):
    with pytest.raises(ConfigError) as refused:
        read(tmp_path, ONE.replace(old, new))
    assert str(refused.value).startswith(f"{tmp_path / 'device.xml'}:{line}: ")
    assert any(each in str(refused.value) for each in said.split("|"))


MAKERS = """\
<?xml version="1.0" encoding="{encoding}"?>
<!-- one file for a whole series, as makers of terminals write them -->
<EtherCATInfo xmlns:xsi="http://www.w3.org/2001/XMLSchema-instance" xsi:noNamespaceSchemaLocation="EtherCATInfo.xsd" \
Version="1.6">
  <Vendor FileVersion="3"><Id>#x0000BEEF</Id><Name>Meßtechnik GmbH</Name><ImageData16x14>424D</ImageData16x14></Vendor>
  <Descriptions>
    <Groups><Group SortOrder="8"><Type>AnaIn</Type><Name LcId="1033"><![CDATA[Analogue inputs]]></Name></Group></Groups>
    <Devices>
      <Device Invisible="1"><Type>Coupler without a code</Type></Device>
      <Device><Type ProductCode="#x0c1e3052" RevisionNo="oops">Broken neighbour</Type></Device>
      <Device Physics="YY">
        <Type ProductCode="#x0C1F3052" RevisionNo="#x00110000" CheckRevisionNo="EQ_OR_G">M3102</Type>
        <HideType RevisionNo="#x00100000"/>
        <Name LcId="1031"><![CDATA[M3102 2K. Ana. Eingang ±10V]]></Name>
        <Name LcId=" 1033 "><![CDATA[M3102 2Ch. Ana. Input +/-10V, (DIFF)]]></Name>
        <Info><StateMachine><Timeout><PreopTimeout>2000</PreopTimeout></Timeout></StateMachine></Info>
        <GroupType>AnaIn</GroupType>
        <Profile><ProfileNo>5001</ProfileNo><Dictionary><DataTypes>
          <DataType><Name>DT_GRAD</Name><BaseType>INT</BaseType><BitSize>16</BitSize></DataType>
          <DataType><Name>DT_LOOP</Name><BaseType>DT_LOOP</BaseType><BitSize>16</BitSize></DataType>
        </DataTypes></Dictionary></Profile>
        <Fmmu>Outputs</Fmmu><Fmmu>Inputs</Fmmu><Fmmu>MBoxState</Fmmu>
        <Sm MinSize="#x28" MaxSize="128" DefaultSize="128" StartAddress="#x1000" ControlByte="#x26" Enable="#x01">\
MBoxOut</Sm>
        <Sm StartAddress="#x1180" ControlByte="#x20" Enable="1">Inputs</Sm>
        <TxPdo Fixed="true" Sm="3" SU="0">
          <Index DependOnSlot="false">#x1A01</Index><Name LcId="1031">Wert</Name><Name LcId="1033">AI Compact</Name>
          <Exclude>#x1A00</Exclude><Exclude>6658</Exclude>
          <Entry><Index>#x6000</Index><SubIndex>#x11</SubIndex><BitLen>16</BitLen><Name>Value</Name>\
<DataType DScale="+/-10">int</DataType></Entry>
          <Entry><Index>#x6000</Index><SubIndex>18</SubIndex><BitLen>16</BitLen><Name>Grad</Name>\
<DataType>DT_GRAD</DataType></Entry>
          <Entry><Index>#x6000</Index><SubIndex>19</SubIndex><BitLen>16</BitLen><Name>Loop</Name>\
<DataType>DT_LOOP</DataType></Entry>
        </TxPdo>
        <TxPdo Fixed="1" Sm=""><Index>#x1A00</Index><Name>AI Standard</Name></TxPdo>
        <Mailbox DataLinkLayer="1"><CoE SdoInfo="1" CompleteAccess="0"/></Mailbox>
        <Dc><OpMode><Name>FreeRun</Name><AssignActivate>#x0</AssignActivate></OpMode></Dc>
        <Eeprom><ByteSize>2048</ByteSize><ConfigData>0500</ConfigData></Eeprom>
      </Device>
      <Device><Type ProductCode="202321999">M3103</Type><Slots SlotPdoIncrement="1"/></Device>
    </Devices>
  </Descriptions>
</EtherCATInfo>
"""


@pytest.mark.parametrize(
    "data",
    [
        MAKERS.format(encoding="UTF-8").replace("\n", "\r\n").encode(),
        MAKERS.format(encoding="utf-8").encode("utf-8-sig"),
        MAKERS.format(encoding="UTF-16").encode("utf-16"),
        MAKERS.format(encoding="ISO-8859-1").encode("latin-1"),
        MAKERS.format(encoding="windows-1252").encode("cp1252"),
        re.sub(r"<(/?)([A-Z])", r"<\1e:\2", MAKERS.format(encoding="UTF-8")).replace("xmlns:xsi", "xmlns:e").encode(),
    ],
    ids=["dos", "bom", "utf-16", "latin-1", "windows", "namespace"],
)
def test_files_as_makers_write_them(tmp_path, data):
    """A whole series in one file, some of it not as it should be: a terminal is read in spite of its neighbours."""
    (tmp_path / "device.xml").write_bytes(data)
    with pytest.raises(ConfigError, match=r"device\.xml:8: <Type> of Coupler without a code has no"):
        read_esi(tmp_path / "device.xml")
    (device,) = read_esi(tmp_path / "device.xml", 0x0C1F3052)
    assert (device.vendor, device.revision) == (0xBEEF, 0x110000)
    assert device.name == "M3102 2Ch. Ana. Input +/-10V, (DIFF)", "the English of its names"
    assert (device.has_coe, device.maps, device.has_clock, device.has_slots) == (True, False, True, False)
    compact, standard = device.inputs
    assert (compact.index, compact.name, compact.sync_manager) == (0x1A01, "AI Compact", 3)
    assert (compact.excludes, compact.fixed, standard.sync_manager) == ({0x1A00, 6658}, True, None)
    assert [(entry.subindex, entry.type) for entry in compact.entries] == [(17, "INT"), (18, "INT"), (19, "DT_LOOP")]
    assert [(each.kind, each.start, each.bytes) for each in device.sync_managers] == [
        ("MBoxOut", 0x1000, 128),
        ("Inputs", 0x1180, 0),
    ]
    (other,) = read_esi(tmp_path / "device.xml", 202321999)
    assert (other.revision, other.has_slots) == (None, True)
    assert "  revision" not in "".join(lines_of(*terminal_keys(other, set()))), "any will do"
    with pytest.raises(ConfigError, match=r"device\.xml:9: RevisionNo 'oops' is no number"):
        read_esi(tmp_path / "device.xml", 0x0C1E3052)
    assert read_esi(tmp_path / "device.xml", 7) == []
    assert esi_products(tmp_path / "device.xml") == [202321999, 0x0C1E3052, 0x0C1F3052]
    left_out = []
    others = read_esi(tmp_path / "device.xml", left_out=left_out.append)
    assert [str(each).rpartition("/")[2][:13] for each in left_out] == ["device.xml:8:", "device.xml:9:"]
    assert [each.product for each in others] == [0x0C1F3052, 202321999]


def mutated(chance, data):
    """A file with some of its bytes changed, lost, doubled, or moved."""
    data = bytearray(data)
    for _ in range(chance.randint(1, 6)):
        at, length = chance.randrange(len(data)), chance.choice((1, 1, 2, 8, 40))
        match chance.randrange(5):
            case 0:
                data[at] ^= 1 << chance.randrange(8)
            case 1:
                del data[at : at + length]
            case 2:
                data[at:at] = data[at : at + length]
            case 3:
                data[at : at + length] = chance.randbytes(length)
            case 4:
                to = chance.randrange(len(data))
                data[to:to] = data[at : at + length]
        if not data:
            data = bytearray(b" ")
    return bytes(data)


def test_mutated_files_are_read_or_refused_with_one_line(tmp_path):
    chance, refused = random.Random(1), 0
    for _ in range(MUTANTS):
        data = mutated(chance, chance.choice((ONE.encode(), SAMPLE.read_bytes()[:3000], SAMPLE.read_bytes())))
        said = refusal_of(tmp_path, data)
        assert said is None or re.fullmatch(r"[^\n]*device\.xml:\d+: [^\n]+", said), said
        refused += said is not None
    assert MUTANTS / 3 < refused < MUTANTS, "most are broken, some are still files"


def refusal_of(tmp_path, data):
    """What is said against a file; None where it is read, and makes keys."""
    try:
        for device in read(tmp_path, data):
            lines_of(*terminal_keys(device, set()))
    except ConfigError as problem:
        return str(problem)
    return None
