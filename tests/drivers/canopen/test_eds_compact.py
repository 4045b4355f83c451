"""Objects that a DCF keeps short (CompactSubObj), as programs that configure a whole line write them."""

from micromanip_drivers.canopen.dictionary import Dictionary

SHORT = """\
[1016]
ParameterName=Heartbeats
ObjectType=0x08
DataType=0x0007
AccessType=rw
DefaultValue=5
CompactSubObj=12
[1016Value]
NrOfEntries=2
1=0x0003012C
12=010
[1016Name]
NrOfEntries=1
2=of the second
[1600]
ParameterName=Mapping
ObjectType=0x09
DataType=0x0007
AccessType=rw
CompactSubObj=3
[1600value]
NrOfEntries=3
1=0x20000110
2=0x20000208
3=0x20000320
"""


def dictionary(tmp_path, text):
    (tmp_path / "line.dcf").write_text(text)
    return Dictionary(tmp_path / "line.dcf", 3)


def test_parts_that_are_not_listed_are_there(tmp_path):
    found = dictionary(tmp_path, SHORT)
    assert [found.value(0x1600, k) for k in range(4)] == [3, 0x20000110, 0x20000208, 0x20000320]
    assert [found.value(0x1016, k) for k in (0, 1, 2, 11, 12)] == [12, 0x3012C, 5, 5, 8], "set to, by default, octal"
    assert [found.variable(0x1016, k).name for k in (1, 2)] == ["Heartbeats_1", "of the second"]
    assert found.find("of the second").subindex == 2
    assert (found.has(0x1600, 4), found.has(0x1016, 13)) == (False, False)
