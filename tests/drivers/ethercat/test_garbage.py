"""Garbled frames and mails at the master. The campaign `fuzz` tries a million of each.

What is asserted holds whatever came: no crash and no read outside of a buffer (with NUMBA_BOUNDSCHECK=1 such a one is
an error), nothing written besides where it belongs, no output changed, and a refusal in one line where one is due.
"""

import random
import struct

import numpy as np
import pytest
from micromanip_drivers.ethercat import exchange, mailbox
from micromanip_drivers.ethercat.driver import Ethercat
from micromanip_drivers.ethercat.mailbox import Mailbox
from micromanip_drivers.ethercat.scan import FIRST_STATION, Slave

from micromanip.bus.errors import BusError, DeviceFault, LinkError
from micromanip.bus.ethercat.coe import COE, SDO_RESPONSE
from micromanip.bus.ethercat.frames import Datagram
from micromanip.rt.records import SIGNAL
from tests.bus.test_esi import mutated

from .bench import PERIOD_NS, options

pytestmark = pytest.mark.compiled_only

MOST_BYTES = 1472


@pytest.fixture
def count(request):
    return request.config.getoption("--garbage")


def garbage(chance, *of):
    """Bytes without sense, or one of those given with some of it changed, cut, or too long."""
    if chance.random() < 0.2:
        return chance.randbytes(chance.randrange(200))
    return mutated(chance, chance.choice(of))[:MOST_BYTES]


def test_garbage_at_the_master(count):
    """Given to it as the socket would, with the length that came; what is around its place is not touched."""
    chance = random.Random(1)
    driver = Ethercat(options(lock={}), PERIOD_NS)
    context = driver.context()
    c, signals = driver.record(context), np.zeros(48, SIGNAL)
    c["gate"]["sent_count"], c["gate"]["last"][0], k = 100, 12.5, 3
    c["socket"]["received"][:] = 0xA5
    frame = driver._image.frame
    before, sent = {name: c["gate"][name].tobytes() for name in ("last", "recent", "safe")}, c["send"].tobytes()
    for number in range(count):
        data = garbage(chance, frame)
        c["socket"]["received"][k][: len(data)] = np.frombuffer(data, np.uint8)
        c["socket"]["message"][k]["length"] = len(data)
        c["socket"]["now_ns"] = 10**12 + number * PERIOD_NS
        exchange.take_one(c, k, signals, 10**12 + number * PERIOD_NS)
    assert c["received"] == count
    assert c["wrong_length"] + c["not_this_frame"] > 0.5 * count
    assert np.all(np.delete(c["socket"]["received"], k, axis=0) == 0xA5)
    assert {name: c["gate"][name].tobytes() for name in before} == before
    assert c["send"].tobytes() == sent
    assert c["gate"]["state"] in (0, 1, 2)
    assert np.all(np.isfinite(signals["value"]) | (signals["status"] != 0))
    assert np.all(signals["time_ns"] <= 10**12 + count * PERIOD_NS)


def test_garbage_at_both_ends_of_a_ring(count):
    """The same of a cut one, whose halves are put together: no half of another cycle, and no rubbish, completes one."""
    chance = random.Random(7)
    driver = Ethercat(options(return_interface="none1", lock={}), PERIOD_NS)
    context = driver.context()
    c, signals = driver.record(context), np.zeros(48, SIGNAL)
    c["gate"]["sent_count"], k = 100, 3
    c["socket"]["received"][:] = 0xA5
    half = bytearray(driver._image.frame)
    half[6] |= 2
    for at in (driver._image.position_at, driver._image.clock_position_at, driver._image.status_at + 2):
        half[at] = 1
    far = half[:11] + b"\x12" + half[12:]
    before = {name: c["gate"][name].tobytes() for name in ("last", "recent", "safe")}
    for number in range(count):
        data = garbage(chance, bytes(half), bytes(far))
        c["socket"]["received"][k][: len(data)] = np.frombuffer(data, np.uint8)
        c["socket"]["message"][k]["length"] = len(data)
        exchange.take_one_of_ring(c, c["socket"], k, chance.randrange(2), signals, number)
    assert c["received"] == count
    assert c["counted"]["known"] == 1, "some of them were halves of one count"
    assert c["gate"]["acknowledged"] == 0, "no terminal was in OP"
    assert np.all(np.delete(c["socket"]["received"], k, axis=0) == 0xA5)
    assert {name: c["gate"][name].tobytes() for name in before} == before
    assert np.all(signals["sequence"] == 0)


class Babbler:
    """A ``Link`` to a slave that answers each mail with garbage, some of it nearly right."""

    name, lost = "ethercat test", 0

    def __init__(self, chance):
        self.chance, self.asked, self.mails = chance, b"", 0

    def write(self, command, station, register, data):
        self.asked = data
        return Datagram(command, (station, register), data, 1)

    def read(self, command, station, register, length):
        self.mails += 1
        where = self.asked[9:12]
        sdo = self.chance.choice((self.asked[8:16], b"\x4f" + where + b"\2", b"\x41" + where + b"\xff"))
        body = struct.pack("<H", SDO_RESPONSE << 12) + sdo + self.chance.randbytes(self.chance.randrange(12))
        mail = struct.pack("<HHBB", len(body), 0, 0, COE | 0x10) + body
        return Datagram(command, (station, register), garbage(self.chance, mail)[:length].ljust(length, b"\0"), 1)


def test_garbage_in_the_masters_mailbox(count, monkeypatch):
    monkeypatch.setattr(mailbox, "_ANSWER_S", 1e-4)
    chance = random.Random(3)
    slave = Slave(FIRST_STATION, 1, 2, 3, 4, (0x1000, 48), (0x1080, 48))
    babbler, done, refused = Babbler(chance), 0, 0
    box = Mailbox(babbler, slave, "amplifier")
    asks = (
        lambda: box.read(0x1018, 1),
        lambda: box.read(0x1C12, 0),
        lambda: box.write(0x8000, 1, chance.randbytes(chance.choice((1, 4, 8)))),
        lambda: mailbox.apply_mapping(box, "amplifier", "inputs", options().terminals["gauge"].inputs),
    )
    while babbler.mails < count:
        said = refusal_of(chance.choice(asks), BusError)
        assert "\n" not in said
        done, refused = done + (not said), refused + bool(said)
    assert min(done, refused) > 0


def refusal_of(ask, kind):
    """What is said against it; nothing where it is done."""
    try:
        ask()
    except kind as problem:
        return str(problem)
    return ""


def test_an_object_that_is_longer_than_a_mail_is_refused():
    class Long(Babbler):
        def read(self, command, station, register, length):
            sdo = b"\x41" + self.asked[9:12] + struct.pack("<I", 1000)
            mail = struct.pack("<HHBBH", 10, 0, 0, COE | 0x10, SDO_RESPONSE << 12) + sdo
            return Datagram(command, (station, register), mail.ljust(length, b"\0"), 1)

    slave = Slave(FIRST_STATION, 1, 2, 3, 4, (0x1000, 48), (0x1080, 48))
    with pytest.raises(DeviceFault, match="object 0x1018:01 has 1000 bytes, more than one mail holds"):
        Mailbox(Long(random.Random(4)), slave, "amplifier").read(0x1018, 1)


def test_a_slave_that_babbles_is_not_listened_to_for_ever(monkeypatch):
    monkeypatch.setattr(mailbox, "_ANSWER_S", 0.05)

    class Emergencies(Babbler):
        def read(self, command, station, register, length):
            mail = struct.pack("<HHBBH", 10, 0, 0, COE | 0x10, 1 << 12) + bytes(8)
            return Datagram(command, (station, register), mail.ljust(length, b"\0"), 1)

    slave = Slave(FIRST_STATION, 1, 2, 3, 4, (0x1000, 48), (0x1080, 48))
    with pytest.raises(LinkError, match="the mailbox of terminal amplifier does not answer"):
        Mailbox(Emergencies(random.Random(5)), slave, "amplifier").read(0x1018, 1)
