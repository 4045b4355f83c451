"""`micromanip device esi`: what it lists, what it writes is a configuration's, and what it refuses."""

import json
from pathlib import Path

import pytest
import yaml
from micromanip_drivers.ethercat.options import Terminal

from .command import code_of

SAMPLE = Path(__file__).parents[2] / "config" / "ethercat" / "piezo-cell.xml"


def test_several_devices_are_listed(capsys):
    assert code_of("device", "esi", SAMPLE) == 0
    said = capsys.readouterr().out
    assert "0x1003" in said
    assert "Laser tracker" in said


@pytest.mark.parametrize("product", ["0x1004", "4102"])
def test_what_is_written_of_one_are_keys_of_a_terminal(capsys, product):
    assert code_of("device", "esi", SAMPLE, "--product", product) == 0
    ((_, keys),) = yaml.safe_load(capsys.readouterr().out).items()
    assert Terminal.model_validate(keys).product == int(product, 0)


def test_json_has_all_of_it(capsys):
    assert code_of("device", "esi", SAMPLE, "--json") == 0
    devices = json.loads(capsys.readouterr().out)
    assert [next(iter(each["terminal"].values()))["product"] for each in devices] == [0x1003, 0x1004, 0x1005, 0x1006]
    assert devices[0]["terminal"]["piezo_amplifier"]["outputs"]["voltages"]["pdo"] == 0x1600


def a_series(tmp_path, *types):
    """A file of a maker with devices of those types, which have slots."""
    devices = "\n".join(f"<Device><Type {each}>T</Type><Slots/></Device>" for each in types)
    file = tmp_path / "series.xml"
    file.write_text(
        f"<EtherCATInfo><Vendor><Id>2</Id></Vendor><Descriptions><Devices>\n{devices}\n</Devices></Descriptions>"
        "</EtherCATInfo>"
    )
    return file


def test_a_device_without_a_product_code_is_told_and_the_others_are_listed(tmp_path, capsys):
    file = a_series(tmp_path, "", 'ProductCode="#x11"', 'ProductCode="#x12" RevisionNo=""')
    assert code_of("device", "esi", file) == 0
    said = capsys.readouterr()
    assert "0x11" in said.out
    assert "0x12" in said.out
    assert said.err == f"left out: {file}:2: <Type> of T has no ProductCode\n"
    assert code_of("device", "esi", a_series(tmp_path, "")) == 78
    assert f"{file}:2: <Type> of T has no ProductCode" in capsys.readouterr().err


def test_one_of_several_revisions_is_written(tmp_path, capsys):
    file = a_series(tmp_path, *(f'ProductCode="#x11" RevisionNo="#x{n}0000"' for n in (10, 11)))
    assert code_of("device", "esi", file, "--product", "0x11", "--revision", "0x110000") == 0
    said = capsys.readouterr().out
    assert yaml.safe_load(said)["t"] == {"vendor": 2, "product": 0x11, "revision": 0x110000}
    assert "# it has slots: PDOs of the modules in them are not read" in said
    assert code_of("device", "esi", file, "--revision", "1") == 64
    assert "no device with the revision 0x1; it has 0x100000, 0x110000" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("arguments", "code", "said"),
    [
        ([SAMPLE, "--product", "0x99"], 64, "has no device with the product code 0x99"),
        ([SAMPLE, "--product", "amp"], 64, "is no product code"),
        ([SAMPLE.with_suffix(".none")], 64, "No such file"),
        ([__file__], 78, "this is no XML"),
    ],
)
def test_what_is_refused(capsys, arguments, code, said):
    assert code_of("device", "esi", *arguments) == code
    assert said in capsys.readouterr().err
