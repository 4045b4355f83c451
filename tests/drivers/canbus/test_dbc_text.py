"""DBC files of whole machines: what is wrong in them where nobody looks keeps no message from being used."""

import pytest
from micromanip_drivers.canbus.database import Database

from micromanip.errors import ConfigError

MACHINE = """VERSION ""
NS_ :
\tCM_
\tVAL_
\tVAL_TABLE_
BS_:
BU_: A
BO_ 1 Plain: 8 A
 SG_ value : 0|16@1- (0.5,-3) [0|0] "" A
BO_ 300000000 Forgotten: 8 A
 SG_ part : 0|32@1- (1,0) [0|0] "" A

BO_ 4294967294 Beyond: 8 A
 SG_ value : 0|16@1+ (1,0) [0|0] "" A
BO_ 648 Unled: 8 A
 SG_ which m : 6|2@1+ (1,0) [0|3] "" A
 SG_ code m2 : 0|6@1+ (1,0) [0|63] "" A
 SG_ load m3 : 0|6@1+ (10,0) [0|630] "" A
BO_ 2566844926 Parts: 32 A
 SG_ part : 0|32@1+ (1,0) [0|0] "" A
BO_ 3221225472 VECTOR__INDEPENDENT_SIG_MSG: 0 Vector__XXX
 SG_ idle : 0|8@1+ (1,0) [0|0] "" Vector__XXX

CM_ SG_ 1 "which of its signals is not said; BO_ 5 is \\"meant\\"";
CM_ BO_ 1 "of two lines
BO_ 99 NoMessage: 8 A";
CM_ SG_ 300000000 part "of a message that is not there";
BA_DEF_ BO_ "Note" STRING;
BA_DEF_DEF_ "Note" "";
BA_ "Note" BO_ 1 "VAL_ 1 value 0;
BO_ 300000001 NoMessageEither: 8 A";
VAL_ 1 gone 0 "not" 1 "there; at all" ;
VAL_ 300000000 part 0 "x";
VAL_ value_of_no_message 0 "x" ;
SIG_VALTYPE_ 300000000 part : 1;
SG_MUL_VAL_ 648 code which 2-2;
SG_MUL_VAL_ 648 load which 3-3;
"""


@pytest.fixture
def machine(tmp_path):
    (tmp_path / "machine.dbc").write_text(MACHINE)
    return Database(tmp_path / "machine.dbc")


def test_what_nobody_asks_for_is_no_hindrance(machine):
    message = machine.message("receive.Plain", "Plain")
    assert message.decode(b"\xfe\xff" + bytes(6)) == {"value": -4.0}
    assert sorted(each.name for each in machine.by_identifier().values()) == ["Parts", "Plain", "Unled"]


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("Forgotten", r"machine\.dbc:10: .* Identifier 0x11e1a300 has more than 11 bits and is not marked as extended"),
        ("Beyond", r"machine\.dbc:13: .* Extended identifier 0x7ffffffe has more than 29 bits in message Beyond\.$"),
        ("Parts", r"^receive.Parts: Parts has 32 bytes, which classic CAN has not: for CAN FD .* ExtendedCAN_FD$"),
    ],
)
def test_what_is_wrong_is_told_where_it_is_used(machine, name, words):
    with pytest.raises(ConfigError, match=words):
        machine.message(f"receive.{name}", name)


def test_a_comment_that_does_not_end_swallows_nothing(tmp_path):
    """The message behind it would be gone without a word."""
    (tmp_path / "open.dbc").write_text(MACHINE.replace("BO_ 648", 'CM_ "front"\nBO_ 648'))
    with pytest.raises(ConfigError, match=r"open\.dbc:16: it is not a DBC file"):
        Database(tmp_path / "open.dbc")
