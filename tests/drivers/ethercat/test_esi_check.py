"""A configuration beside the ESI files that it names: each difference is refused at its key, with the file's line."""

import re

import pytest
from micromanip_drivers.ethercat.esi_check import compare_with_file, differences
from micromanip_drivers.ethercat.options import Terminal

from campaigns.report import CONFIG
from micromanip.bus.ethercat.esi import read_esi
from micromanip.errors import ConfigError
from micromanip.settings.check import prepare

SAMPLE = CONFIG / "ethercat" / "piezo-cell.xml"
CELL = (CONFIG / "ethercat.yaml").read_text()
FOUND_AT = "        product: {}\n"


def with_files(folder, cell=CELL, sample=None):
    """The cell with the file named at each of its terminals, in `folder`."""
    (folder / "cell.xml").write_text(SAMPLE.read_text() if sample is None else sample)
    for product in ("0x1003", "0x1004", "0x1005", "0x1006"):
        cell = cell.replace(FOUND_AT.format(product), FOUND_AT.format(product) + "        esi: cell.xml\n")
    (folder / "cell.yaml").write_text(cell)
    return folder / "cell.yaml"


def test_the_example_agrees_with_the_sample(tmp_path):
    prepared = prepare(with_files(tmp_path))
    terminals = prepared.wiring.drivers["cell"].options.terminals
    assert [terminal.esi for terminal in terminals.values()] == ["cell.xml"] * 4


@pytest.mark.parametrize(
    ("old", "new", "at", "said"),
    [
        ("revision: 1\n", "revision: 2\n", "revision: 2", "0x2, but the file has 0x1"),
        (
            "strain_y: {index: 0x6000, subindex: 2, type: int32",
            "strain_y: {index: 0x6000, subindex: 4, type: int32",
            "strain_y:",
            "0x6000:04 of 32 bits, but entry 2 is 0x6000:02 of 32 bits, Strain y (DINT)",
        ),
        (
            "stage_x: {index: 0x6000, subindex: 1, type: int32",
            "stage_x: {index: 0x6000, subindex: 1, type: uint32",
            "stage_x:",
            "uint32, but the terminal has DINT, which is int32",
        ),
        (
            "              heartbeat: {index: 0x7001, subindex: 3, type: uint8, switch: true}\n",
            "",
            "fields:",
            "is fixed; missing behind is 0x7001:03 of 8 bits, Heartbeat (USINT)",
        ),
    ],
)
def test_what_differs_is_refused_at_its_key(tmp_path, old, new, at, said):
    assert old in CELL
    file = with_files(tmp_path)
    file.write_text(file.read_text().replace(old, new, 1))
    with pytest.raises(ConfigError) as refused:
        prepare(file)
    (message,) = str(refused.value).splitlines()
    assert said in message
    line = int(re.match(rf"{re.escape(str(file))}:(\d+): ", message)[1])
    assert at in file.read_text().splitlines()[line - 1]
    assert re.search(r"cell\.xml(:\d+\)|; it has)", message), "and where the file says so"


def terminal(**keys):
    return Terminal.model_validate({"vendor": 0x4D4D, "product": 0x1006} | keys)


def of_tracker(tmp_path, *changes):
    text = SAMPLE.read_text()
    text = text[: text.index("<Device Physics")] + text[text.rindex("<Device Physics") :]
    for old, new in changes:
        assert old in text
        text = text.replace(old, new)
    (tmp_path / "tracker.xml").write_text(text)
    (device,) = read_esi(tmp_path / "tracker.xml")
    return device


COUNT = {"count": {"index": 0x6000, "subindex": 1, "type": "uint8"}}


def test_a_pdo_that_may_be_mapped_need_not_be_mapped_whole(tmp_path):
    device, some = of_tracker(tmp_path), terminal(inputs={"deviation": {"pdo": 0x1A00, "fields": COUNT}})
    assert list(differences(some, device)) == []
    for change in (('PdoConfig="1"', 'PdoConfig="0"'), ('Fixed="0"', 'Fixed="1"')):
        ((key, what, _),) = differences(some, of_tracker(tmp_path, change))
        assert key == "inputs.deviation.fields"
        assert "missing behind is 0x6001:01" in what


def test_pdos_that_exclude_each_other_and_one_that_is_mandatory(tmp_path):
    second = "<Index>#x1a00</Index>", "<Index>#x1a00</Index><Exclude>#x1a01</Exclude>"
    other = "<Mailbox>", '<TxPdo Mandatory="1"><Index>#x1a01</Index><Name>More</Name></TxPdo><Mailbox>'
    device = of_tracker(tmp_path, second, other)
    one = {"deviation": {"pdo": 0x1A00, "fields": COUNT}}
    both = one | {"more": {"pdo": 0x1A01, "fields": {"other": COUNT["count"]}}}
    assert [what for _, what, _ in differences(terminal(inputs=one), device)] == [
        "PDO 0x1a01, More, is mandatory and missing"
    ]
    assert "it excludes 0x1a01, which is assigned as well" in [
        what for _, what, _ in differences(terminal(inputs=both), device)
    ]


def test_the_newest_revision_is_meant_where_any_will_do(tmp_path):
    text = SAMPLE.read_text()
    tracker = text[text.rindex("      <Device Physics") : text.rindex("    </Devices>")]
    older = (
        tracker.replace('RevisionNo="#x0001"', 'RevisionNo="#x0000"')
        .replace("#x6001", "#x6009")
        .replace("#x1a00", "#x1a07")
    )
    (tmp_path / "two.xml").write_text(text.replace(tracker, older + tracker))
    any_of_them = terminal(esi="two.xml", inputs={"deviation": {"pdo": 0x1A00, "fields": COUNT}})
    compare_with_file("tracker", any_of_them, tmp_path)
    with pytest.raises(ConfigError, match=r"terminals\.tracker\.inputs\.deviation\.pdo: there is no PDO 0x1a00 among"):
        compare_with_file("tracker", any_of_them.model_copy(update={"revision": 0}), tmp_path)
