"""`micromanip device esi`: what it lists, what it writes is a configuration's, and what it refuses."""

import pytest
import yaml
from micromanip_drivers.ethercat.options import Terminal

from campaigns.report import CONFIG

from .command import code_of

SAMPLE = CONFIG / "ethercat" / "piezo-cell.xml"


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
