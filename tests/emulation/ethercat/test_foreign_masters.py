"""Masters that others wrote bring the emulated slaves to OP, unmodified; what went over the wire is dissected."""

import asyncio
import shutil
import struct
import subprocess

import pytest

from .wire import slaves, until, veth

pysoem = pytest.importorskip("pysoem")
kickcat = pytest.importorskip("kickcat")
ebpfcat = pytest.importorskip("ebpfcat.ethercat")
pytestmark = [pytest.mark.live, pytest.mark.compiled_only, pytest.mark.xdist_group("ethercat")]

LONG = bytes(range(1, 9))
OUTPUTS = struct.pack("<iiiBB", 100, -200, 300, 1, 0)


@pytest.fixture(scope="module")
def wire():
    with veth("ecf") as (here, there), slaves(there):
        yield here


@pytest.fixture
def soem(wire):
    pysoem.settings.timeouts.ret, pysoem.settings.timeouts.safe = 100_000, 1_000_000
    master = pysoem.Master()
    master.open(wire)
    yield master
    master.state = pysoem.INIT_STATE
    master.write_state()
    master.close()


def test_pysoem_finds_the_terminals_by_their_eeprom(soem):
    assert soem.config_init() == 2
    assert [(slave.name, slave.man, slave.id, slave.rev) for slave in soem.slaves] == [
        ("Piezo amplifier", 0x1234, 0x10, 3),
        ("Strain gauge", 0x1234, 0x20, 2),
    ]


def test_pysoem_reads_and_writes_objects(soem):
    soem.config_init()
    slave = soem.slaves[0]
    assert slave.sdo_read(0x1018, 4) == struct.pack("<I", 1001)
    assert slave.sdo_read(0x1008, 0) == b"Piezo amplifier"
    slave.sdo_write(0x8000, 1, b"\7\0")
    slave.sdo_write(0x8001, 1, LONG)
    assert slave.sdo_read(0x8000, 1) == b"\7\0"
    assert slave.sdo_read(0x8001, 1, len(LONG)) == LONG
    with pytest.raises(pysoem.SdoError) as refused:
        slave.sdo_read(0x5555, 1)
    assert refused.value.abort_code == 0x06020000
    with pytest.raises(pysoem.SdoError) as refused:
        slave.sdo_write(0x8000, 1, b"\7\0\0\0")
    assert refused.value.abort_code == 0x06070010


def test_pysoem_reaches_OP_and_the_watchdog_ends_it(soem):
    soem.config_init()
    soem.config_map()
    assert soem.config_dc()
    amplifier, gauge = soem.slaves
    assert (len(amplifier.output), len(amplifier.input), len(gauge.input)) == (14, 2, 12)
    assert soem.state_check(pysoem.SAFEOP_STATE, 5_000_000) == pysoem.SAFEOP_STATE
    amplifier.output, counters = OUTPUTS, []

    def operates():
        soem.send_processdata()
        counters.append(soem.receive_processdata(1_000_000))
        soem.state = pysoem.OP_STATE | (pysoem.STATE_ACK if amplifier.state & pysoem.STATE_ACK else 0)
        soem.write_state()
        return soem.state_check(pysoem.OP_STATE, 5_000) == pysoem.OP_STATE

    assert until(operates)
    assert counters[-1] == soem.expected_wkc == 4
    first = soem.dc_time
    assert until(lambda: soem.send_processdata() and soem.receive_processdata(1_000_000) == 4 and soem.dc_time > first)

    def dropped():
        soem.read_state()
        return amplifier.state == pysoem.SAFEOP_STATE | pysoem.STATE_ACK

    assert until(dropped)
    assert pysoem.al_status_code_to_string(amplifier.al_status) == "Sync manager watchdog"
    assert gauge.state == pysoem.OP_STATE  # it has no outputs to watch


def test_pysoem_is_told_why_a_state_is_refused(soem):
    soem.config_init()
    soem.state = pysoem.OP_STATE  # from PREOP
    soem.write_state()
    slave = soem.slaves[0]
    assert until(lambda: soem.read_state() and slave.state & pysoem.STATE_ACK)
    assert pysoem.al_status_code_to_string(slave.al_status) == "Invalid requested state change"


async def met_by_ebpfcat(wire):
    """What it read of both terminals on the way to SAFEOP."""
    line = ebpfcat.EtherCat(wire)
    await line.connect()
    assert await line.count() == 2
    for place in range(2):
        terminal = ebpfcat.Terminal(line)
        await terminal.initialize(-place, place + 1)
        await terminal.to_operational(ebpfcat.MachineState.PRE_OPERATIONAL)
        objects = [await terminal.sdo_read(*at) for at in ((0x1018, 4), (0x1008, 0))]
        with pytest.raises(ebpfcat.EtherCatError, match="got 7"):  # no SDO information, but an answer
            await terminal.read_ODlist()
        await terminal.parse_pdos()
        await terminal.to_operational(ebpfcat.MachineState.SAFE_OPERATIONAL)
        yield terminal, objects, {at: (to.name, byte) for at, (to, byte, _) in terminal.pdos.items()}
    line.transport.close()


def test_ebpfcat_which_writes_a_mail_in_two_strokes_reaches_safe_operational(wire):
    """Its length and head first, then the last byte, which hands the mailbox over; that second one was not taken."""

    async def all_of_them():
        return [met async for met in met_by_ebpfcat(wire)]

    amplifier, gauge = asyncio.run(all_of_them())
    assert amplifier[1] == [struct.pack("<I", 1001), b"Piezo amplifier"]
    assert amplifier[0].serialNo == 1001
    assert gauge[0].productCode == 0x20
    voltages = {(0x7000, 1): ("OUT", 0), (0x7000, 2): ("OUT", 4), (0x7000, 3): ("OUT", 8)}
    assert voltages.items() <= amplifier[2].items(), amplifier[2]
    assert [byte for to, byte in gauge[2].values() if to == "IN"] == [0, 4, 8]


def test_pysoem_packs_two_digital_terminals_into_one_byte_and_reads_the_same_bits():
    with veth("ecg") as (here, there), slaves(there, "digital"):
        pysoem.settings.timeouts.ret, pysoem.settings.timeouts.safe = 100_000, 1_000_000
        master = pysoem.Master()
        master.open(here)
        try:
            assert master.config_init() == 3
            master.config_map()
            low, high, read = master.slaves
            assert (low.name, len(low.output), len(high.output), len(read.input)) == ("Digital outputs 1", 1, 1, 1)
            assert master.state_check(pysoem.SAFEOP_STATE, 5_000_000) == pysoem.SAFEOP_STATE
            said = []

            def operates():
                master.send_processdata()
                said.append(master.receive_processdata(1_000_000))
                master.state = pysoem.OP_STATE
                master.write_state()
                return master.state_check(pysoem.OP_STATE, 5_000) == pysoem.OP_STATE

            assert until(operates)
            assert said[-1] == 2 + 2 + 1  # its own expectation counts the byte that two share once

            def reads(pins):
                low.output = bytes([pins])  # the byte that both terminals share
                master.send_processdata()
                master.receive_processdata(1_000_000)
                return read.input == bytes([pins])

            for pins in (0xA5, 0x0F, 0xF0, 0x81):
                assert until(lambda pins=pins: reads(pins))
        finally:
            master.state = pysoem.INIT_STATE
            master.write_state()
            master.close()


def kickcat_bus(wire):
    """It takes the whole time-out for each frame of its start: first a short one, longer on a busy machine."""
    for timeout_s in (0.01, 0.1, 0.5):
        link = kickcat.create_link(wire, "")
        link.set_timeout(timeout_s)
        bus = kickcat.Bus(link)
        try:
            bus.init(5.0)
        except RuntimeError as problem:
            said = problem
        else:
            return link, bus
    raise said


def test_kickcat_reads_objects_and_reaches_OP(wire):
    link, bus = kickcat_bus(wire)
    link.set_timeout(1.0)
    amplifier, gauge = bus.slaves()
    access = kickcat.Access.PARTIAL
    assert bus.read_sdo(amplifier, 0x1018, 4, access, 4, 5.0) == struct.pack("<I", 1001)
    assert bus.read_sdo(gauge, 0x1008, 0, access, 64, 5.0) == b"Strain gauge"
    bus.create_mapping()
    assert (amplifier.output_size, amplifier.input_size, gauge.input_size) == (14, 2, 12)
    bus.request_state(kickcat.State.SAFE_OP)
    bus.wait_for_state(kickcat.State.SAFE_OP, 5.0)
    amplifier.set_output_bytes(OUTPUTS)

    def operates():
        bus.process_data_no_check()
        bus.request_state(kickcat.State.OPERATIONAL)
        return {str(bus.get_state(slave)) for slave in bus.slaves()} == {str(kickcat.State.OPERATIONAL)}

    assert until(operates)


@pytest.mark.skipif(shutil.which("tshark") is None, reason="needs tshark")
def test_tshark_finds_nothing_amiss(wire, soem, tmp_path):
    file = tmp_path / "wire.pcap"
    with subprocess.Popen(
        ["tshark", "-i", wire, "-q", "-w", str(file), "-c", "300"], stderr=subprocess.PIPE, text=True
    ) as tshark:
        while "Capturing" not in (line := tshark.stderr.readline()):
            assert line, "tshark does not capture"
        assert until(lambda: soem.config_init() == 2 and soem.config_map() and tshark.poll() is not None)
    found = subprocess.run(
        ["tshark", "-r", str(file), "-T", "fields", "-e", "frame.protocols", "-e", "_ws.expert.message"],
        capture_output=True,
        text=True,
        check=True,
    ).stdout.splitlines()
    assert len(found) == 300
    assert all("ecat" in line for line in found)
    complaints = {line.split("\t")[1] for line in found if "\t" in line} - {""}
    assert all("Source MAC" in complaint for complaint in complaints), complaints  # SOEM's own choice
