"""PDOs of a terminal without a mailbox, as its EEPROM lists them: only those that lie in the area that is exchanged."""

import pytest
from micromanip_drivers.ethercat.scan import in_one_area

ONE, BYTE, NIBBLE = [0x70000101], [0x70000108], [0x70000104]


@pytest.mark.parametrize(
    ("pdos", "starts", "exchanged"),
    [
        ([(0, 0x1600, BYTE), (1, 0x1601, BYTE)], [0xF00, 0xF01], [0x1600, 0x1601]),
        ([(0, 0x1600 + k, ONE) for k in range(8)] + [(1, 0x1608, ONE)], [0xF00, 0xF01], [*range(0x1600, 0x1609)]),
        ([(1, 0x1700, BYTE), (2, 0x1800, BYTE)], [0x1000, 0x1200, 0x1300], [0x1700]),
        ([(1, 0x1700, BYTE), (2, 0x1800, BYTE), (1, 0x1701, BYTE)], [0x1000, 0x1200, 0x1300], [0x1700, 0x1701]),
        ([(0, 0x1600, NIBBLE), (1, 0x1601, NIBBLE)], [0xF00, 0xF01], [0x1600]),
        ([(0, 0x1600, BYTE), (1, 0x1601, BYTE)], [], [0x1600, 0x1601]),
    ],
    ids=["behind", "bits behind", "apart", "and again", "not at a byte", "an older EEPROM"],
)
def test_what_lies_elsewhere_is_not_exchanged(pdos, starts, exchanged):
    assert [index for index, _ in in_one_area(pdos, starts)] == exchanged
