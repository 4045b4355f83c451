"""What makers write into ESI files, and what a configuration begins with."""

import pytest

from micromanip.bus.ethercat.esi import read_esi
from micromanip.bus.ethercat.esi_keys import lines_of, not_mapped, remarks, terminal_keys


def entry(index, bits, kind="", name="x", subindex=0):
    kind = f"<DataType{kind if kind.startswith((' ', '>')) else '>' + kind}</DataType>" if kind else ""
    return (
        f"<Entry><Index>{index}</Index><SubIndex>{subindex}</SubIndex><BitLen>{bits}</BitLen><Name>{name}</Name>{kind}"
        "</Entry>"
    )


def pdo(index, *entries, tag="TxPdo", keys='Sm="3"', more=""):
    return f"<{tag} {keys}><Index>{index}</Index><Name>P</Name>{more}{''.join(entries)}</{tag}>"


MANAGERS = "".join(f'<Sm StartAddress="#x{start:x}"/>' for start in (0xF00, 0xF01, 0x1200, 0x1300))


def device(tmp_path, *parts, head="<Vendor><Id>2</Id></Vendor>", code="7"):
    text = "".join((MANAGERS, *parts))
    (tmp_path / "maker.xml").write_text(
        f"<EtherCATInfo>{head}<Descriptions><Devices><Device><Type ProductCode='{code}'>T</Type>{text}</Device>"
        "</Devices></Descriptions></EtherCATInfo>"
    )
    (found,) = read_esi(tmp_path / "maker.xml")
    return found


def types(found):
    (of_pdo,) = terminal_keys(found, set())[1]["inputs"].values()
    return [(each["type"], each.get("spare", False)) for each in of_pdo["fields"].values()]


@pytest.mark.parametrize(
    ("kind", "bits", "ours"),
    [
        ("UINT16", 16, ("uint16", False)),
        ("INT8", 8, ("int8", False)),
        ("float32", 32, ("float32", False)),
        ("USINT", 3, ("bit3", False)),
        ("BITARR16", 12, ("bit12", False)),
        ("UDINT", 1, ("bool", False)),
        ("INT", 12, ("bit12", True)),
        ("UDINT", 16, ("uint16", True)),
        ("BOOL", 8, ("uint8", True)),
        ("STRING(2)", 16, ("uint16", True)),
        ("", 32, ("uint32", True)),
        ("DT_ENUM", 3, ("bit3", False)),
        ("DT_FAR", 16, ("int16", False)),
        ("DT_RING", 16, ("uint16", True)),
    ],
)
def test_what_is_no_number_of_ours_is_spare(tmp_path, kind, bits, ours):
    own = "".join(
        f"<DataType><Name>{name}</Name><BaseType>{base}</BaseType></DataType>"
        for name, base in (("DT_ENUM", "USINT"), ("DT_FAR", "DT_NEAR"), ("DT_NEAR", "INT"), ("DT_RING", "DT_RING"))
    )
    dictionary = f"<Profile><Dictionary><DataTypes>{own}</DataTypes></Dictionary></Profile>"
    found = device(tmp_path, dictionary, pdo("#x1a00", entry("#x6000", bits, kind)))
    assert types(found) == [ours]
    assert list(not_mapped(found)) == []
    said = "\n".join(lines_of(*terminal_keys(found, set())))
    assert (", spare: true}" in said) == ours[1]
    assert any("is spare: its type is not known" in each for each in remarks(found)) == ours[1]


def begun(found):
    keys = terminal_keys(found, set())[1]
    return [[each["pdo"] for each in keys.get(direction, {}).values()] for direction in ("outputs", "inputs")]


def test_of_pdos_that_exclude_each_other_the_first_is_taken(tmp_path):
    one = entry("#x6000", 16, "INT")
    found = device(
        tmp_path,
        pdo("#x1a00", one),
        pdo("#x1a01", one, more="<Exclude>#x1a00</Exclude>"),
        pdo("#x1a02", one),
        pdo("#x1a03", one, keys=""),
    )
    assert begun(found) == [[], [0x1A00, 0x1A02]]
    assert list(remarks(found)) == ["PDO 0x1a01 P: left out, it and 0x1a00 exclude each other"]


@pytest.mark.parametrize(
    ("managers", "bits", "taken"),
    [
        ((0, 1), 8, [0x1600, 0x1601]),
        ((0, 1), 4, [0x1600]),
        ((0, 1), 16, [0x1600]),
        ((2, 3), 8, [0x1600]),
        ((0, 9), 8, [0x1600]),
        ((2, 2), 4, [0x1600, 0x1601]),
    ],
)
def test_pdos_that_lie_behind_each_other_are_one_area(tmp_path, managers, bits, taken):
    one = entry("#x7000", bits, f"BITARR{bits}")
    first, second = (
        pdo(f"#x160{k}", one, tag="RxPdo", keys=f'Sm="{manager}" Mandatory="1"') for k, manager in enumerate(managers)
    )
    found = device(tmp_path, first, second)
    assert begun(found) == [taken, []]
    apart = [each for each in remarks(found) if "lies apart from that of 0x1600; it is mandatory" in each]
    assert len(apart) == 2 - len(taken)


@pytest.mark.parametrize(
    ("encoding", "name"),
    [
        ("GB2312", "伺服驱动器"),
        ("gbk", "伺服驅動器"),
        ("Shift_JIS", "サーボ①"),
        ("EUC-KR", "서보 드라이브"),
        ("big5", "伺服驅動器"),
    ],
)
def test_files_of_the_far_east(tmp_path, encoding, name):
    """Two bytes of a letter may be a `\\` or a `|`, and a file says GB2312 that has letters of GBK."""
    one = pdo("#x1a00", entry("#x6000", 16, "INT", name))
    text = (
        f'<?xml version="1.0" encoding="{encoding}"?>\n<EtherCATInfo><Vendor><Id>2</Id></Vendor><Descriptions><Devices>'
        f'\n<Device><Type ProductCode="1">T</Type><Name>{name}</Name>{one}</Device></Devices></Descriptions>'
        "</EtherCATInfo>"
    )
    (tmp_path / "far.xml").write_bytes(text.encode({"Shift_JIS": "cp932"}.get(encoding, encoding)))
    (found,) = read_esi(tmp_path / "far.xml")
    assert (found.name, found.inputs[0].entries[0].name, found.line) == (name, name, 3)
    (tmp_path / "far.xml").write_bytes(text.encode("gbk", "replace").replace(b"T</Type>", b"\x81\xff</Type>"))
    assert read_esi(tmp_path / "far.xml")[0].product == 1, "what is no letter is no reason"
