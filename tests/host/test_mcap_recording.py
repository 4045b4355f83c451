"""A recording in MCAP: what the ring held, read by us and by the format's own library, however its writer ended."""

import io
import json
import os
import resource
import signal
import struct
import subprocess
import sys
import time

import numpy as np
import pytest
from mcap.exceptions import McapError
from mcap.reader import NonSeekingReader, make_reader

from micromanip.errors import CheckFailed
from micromanip.host.recording.mcap_file import McapRecording
from micromanip.recordings import open_telemetry, read_table
from micromanip.recordings.blocks import BlockCodec
from micromanip.replay.recorded import Recorded
from micromanip.rt.records import CELL_PARAMETERS, CELL_STATE
from micromanip.rt.telemetry import ROW
from tests.cli.command import code_of

PERIOD_NS = 100_000
CONFIGURATION = "schema_version: 2  # µ\n"


def begun(file, axes=("x", "y")):
    orders = {"file": str(file), "configuration": CONFIGURATION, "sha256": "abc", "axes": list(axes)}
    recording = McapRecording(orders | {"period_ns": PERIOD_NS})
    state = np.zeros(1, CELL_STATE)
    state["cycle"] = 41
    recording.begin(state[0])
    return recording


def slots(*versions):
    sets = np.zeros(len(versions), CELL_PARAMETERS)
    sets["version"] = versions
    return sets


def some_rows(first, count, version=1):
    noise = np.random.default_rng(first)
    rows = np.zeros(count, ROW)
    rows["cycle"], rows["periods"], rows["version"] = np.arange(first, first + count), 1, version
    rows["time_ns"] = rows["cycle"] * PERIOD_NS
    for field in ("stage_um", "innovation_um", "voltage_V", "path_error_um"):
        rows["axis"][field] = noise.standard_normal((count, 3))
    rows["axis"]["true_stage_um"] = np.nan
    return rows


def all_rows(file):
    return np.concatenate([np.zeros(0, ROW), *open_telemetry(file).rows()])


def messages(file, reader=make_reader):
    """What the library reads: topic, message; to the place where the file ends."""
    with file.open("rb") as stream:
        try:
            for _, channel, message in reader(stream).iter_messages(log_time_order=False):
                yield channel.topic, message
        except (McapError, struct.error):
            assert stream.read() == b""


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    """A file that was ended in order, and the rows that went into it."""
    file = tmp_path_factory.mktemp("mcap") / "run.mcap"
    rows = np.concatenate([some_rows(42, 1700), some_rows(1742, 900, version=3)])
    recording = begun(file)
    recording.append(rows[:500], slots(1))
    recording.mark("coolant on", 541, "alice", 541 * PERIOD_NS)
    recording.append(rows[500:], slots(3, 1))
    recording.note_lost(5)
    recording.close()
    return file, rows


def test_our_reader(recorded):
    file, rows = recorded
    telemetry = open_telemetry(file)
    assert all_rows(file).tobytes() == rows.tobytes()
    assert telemetry.dtype == ROW
    assert (telemetry.axes, telemetry.period_ns, telemetry.sha256) == (["x", "y"], PERIOD_NS, "abc")
    assert telemetry.configuration == CONFIGURATION
    assert telemetry.state["cycle"] == 41
    assert [int(each["version"][0]) for each in telemetry.parameters] == [1, 3]
    assert telemetry.end == {"rows": 2600, "lost": 5}
    marks = [(mark["text"], mark["cycle"], mark["by"]) for mark in telemetry.marks]
    assert marks == [("recording began", 41, "recorder"), ("coolant on", 541, "alice")]


def test_columns_have_the_names_of_the_fields_and_axes(recorded):
    file, rows = recorded
    table = read_table(file)
    assert (table["stage_um_y"] == rows["axis"]["stage_um"][:, 1]).all()
    assert (table["version"] == rows["version"]).all()
    assert table["t_s"] == pytest.approx((rows["cycle"] - 42) * 1e-4)
    assert table.time_column() == "t_s"
    assert "stage_um_z" not in table


def test_the_library_reads_it(recorded):
    """By the index, with checksums; decoded by nothing but the schema in it."""
    file, rows = recorded
    with file.open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True)
        blocks = [(schema, message.data) for schema, _, message in reader.iter_messages(topics=["/rows"])]
        (configuration,) = (each for each in reader.iter_attachments() if each.name == "configuration.yaml")
        (about,) = (each.metadata for each in reader.iter_metadata() if each.name == "micromanip")
        states = [np.load(io.BytesIO(each.data)) for each in reader.iter_attachments() if each.name == "state.npy"]
    codec = BlockCodec.described(json.loads(blocks[0][0].data))
    assert b"".join(codec.rows(data).tobytes() for _, data in blocks) == rows.tobytes()
    assert configuration.data.decode() == CONFIGURATION
    assert (about["sha256"], json.loads(about["axes"])) == ("abc", ["x", "y"])
    assert states[0]["cycle"] == 41


def test_scalars_for_viewers(recorded):
    """A JSON object each 20 ms, with its schema; what is not known is left out."""
    file, rows = recorded
    with file.open("rb") as stream:
        found = list(make_reader(stream).iter_messages(topics=["/axis/y"]))
    assert {schema.encoding for schema, _, _ in found} == {"jsonschema"}
    times = np.array([message.log_time for _, _, message in found])
    assert (np.diff(times) == 20_000_000).all()
    assert len(found) == 13
    first = json.loads(found[0][2].data)
    assert first["stage_um"] == pytest.approx(rows["axis"]["stage_um"][0, 1], abs=1e-6)
    assert "true_stage_um" not in first
    known = json.loads(found[0][0].data)["properties"]
    assert set(first) < set(known)


def test_cut_anywhere(recorded, tmp_path):
    """Whatever is there as a whole is read; nothing else is taken for it."""
    file, rows = recorded
    content = file.read_bytes()
    cut = tmp_path / "cut.mcap"
    begun(tmp_path / "begun.mcap")
    least = (tmp_path / "begun.mcap").stat().st_size
    seen = []
    for size in np.linspace(0, len(content), 60).astype(int):
        cut.write_bytes(content[:size])
        try:
            found = all_rows(cut)
        except CheckFailed:
            assert size < least
            continue
        assert found.tobytes() == rows[: len(found)].tobytes()
        seen.append(len(found))
    assert seen == sorted(seen)
    assert seen[-1] == len(rows)
    assert len(set(seen)) >= 3


def test_a_damaged_file_is_told(recorded, tmp_path):
    file, _ = recorded
    content = bytearray(file.read_bytes())
    with file.open("rb") as stream:
        chunk = make_reader(stream).get_summary().chunk_indexes[0]
    content[chunk.chunk_start_offset + chunk.chunk_length // 2] ^= 0xFF
    (tmp_path / "damaged.mcap").write_bytes(content)
    with pytest.raises(CheckFailed, match=r"damaged.mcap: it is damaged"):
        all_rows(tmp_path / "damaged.mcap")


@pytest.mark.parametrize("name", ["state.npy", "parameters-3.npz", "configuration.yaml"])
def test_what_is_damaged_beside_the_rows_is_left_out_and_told(recorded, tmp_path, capsys, name):
    """A bit that flips there fails no parser: a replay would run with another gain."""
    file, rows = recorded
    content = bytearray(file.read_bytes())
    content[content.index(name.encode()) + 50] ^= 0x10
    damaged = tmp_path / "damaged.mcap"
    damaged.write_bytes(content)
    telemetry = open_telemetry(damaged)
    assert telemetry.damaged == [name]
    assert (telemetry.state is None, len(telemetry.parameters), telemetry.configuration == "") == (
        name == "state.npy", 1 if "parameters" in name else 2, name == "configuration.yaml"
    )  # fmt: skip
    assert all_rows(damaged).tobytes() == rows.tobytes()
    assert code_of("recording", "export", damaged, "--to", tmp_path / "part.csv", "--cut", "0:0.01") == 0
    assert f"damaged.mcap: Damaged, and left out: {name}." in capsys.readouterr().err
    with pytest.raises(CheckFailed, match=rf"damaged.mcap: damaged: the checksum of {name} in it is wrong"):
        telemetry.sure_configuration() if name == "configuration.yaml" else Recorded(telemetry)


def test_another_program_s_mcap_is_told(tmp_path):
    from mcap.writer import Writer

    file = tmp_path / "robot.mcap"
    with file.open("wb") as stream:
        writer = Writer(stream)
        writer.start()
        writer.add_message(writer.register_channel("/pose", "json", 0), 0, b'{"x": 1}', 0)
        writer.finish()
    with pytest.raises(CheckFailed, match=r"robot.mcap: an MCAP file of another program"):
        read_table(file)


def test_a_recording_replaces_nothing(tmp_path):
    (tmp_path / "run.mcap").write_text("precious")
    with pytest.raises(FileExistsError):
        begun(tmp_path / "run.mcap")
    (tmp_path / "link.mcap").symlink_to(tmp_path / "elsewhere")
    with pytest.raises(OSError, match="exists"):
        begun(tmp_path / "link.mcap")
    assert (tmp_path / "run.mcap").read_text() == "precious"
    assert not (tmp_path / "elsewhere").exists()


WRITER = """
import sys, numpy as np
from host.test_mcap_recording import begun, some_rows, slots
recording, first = begun(sys.argv[1]), 42
print("begun", flush=True)
while True:
    recording.append(some_rows(first, 500), slots(1))
    first += 500
    print(first, flush=True)
"""


def writing(file):
    """A process that writes without a pause, and says up to which cycle it has."""
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
    writer = subprocess.Popen([sys.executable, "-c", WRITER, str(file)], stdout=subprocess.PIPE, env=environment)
    assert writer.stdout.readline() == b"begun\n"
    return writer


def test_killed_at_any_moment(tmp_path, kills):
    """What it said to be written is there, bit for bit, to us and to the library; nothing has to be mended."""
    for number in range(kills):
        file = tmp_path / f"{number}.mcap"
        writer = writing(file)
        time.sleep(0.003 * (number % 50) + 0.02)
        writer.send_signal(signal.SIGKILL)
        said = writer.stdout.read().split()
        writer.wait()
        writer.stdout.close()
        written = int(said[-1]) - 42 if said else 0
        rows = all_rows(file)
        assert written <= len(rows) <= written + 500
        assert (rows["cycle"] == np.arange(42, 42 + len(rows))).all()
        for first in range(0, len(rows), 500):
            assert rows[first : first + 500].tobytes() == some_rows(42 + first, 500).tobytes()
        codec = BlockCodec.of(ROW)
        theirs = [codec.rows(message.data) for topic, message in messages(file, NonSeekingReader) if topic == "/rows"]
        assert b"".join(part.tobytes() for part in theirs) == rows.tobytes()
        file.unlink()


def test_a_file_that_may_not_grow(tmp_path):
    """The write that fails leaves nothing behind; what was before it is whole."""
    file = tmp_path / "run.mcap"
    writer = writing(file)
    resource.prlimit(writer.pid, resource.RLIMIT_FSIZE, (900_000, 900_000))
    said = writer.stdout.read().split()
    assert writer.wait() == 1
    writer.stdout.close()
    rows = all_rows(file)
    assert len(rows) == int(said[-1]) - 42 > 0
    assert (rows["cycle"] == np.arange(42, 42 + len(rows))).all()
    assert file.stat().st_size <= 900_000
