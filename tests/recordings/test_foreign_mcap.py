"""Our messages as other programs save them again: other chunks, other compression, channels and files of their own."""

import json

import numpy as np
import pytest
from host.test_mcap_recording import begun, slots, some_rows

pytest.importorskip("mcap")
from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer

from micromanip.design.recorded_run import RecordedRun
from micromanip.errors import CheckFailed
from micromanip.recordings import open_telemetry
from micromanip.recordings.loader import Wanted, take
from micromanip.recordings.reading import read_table


def written_again(source, target, compression, chunk_bytes):
    """A picture of a camera between the messages, large enough for chunks of its own; `chunk_bytes` 0: no chunks."""
    with source.open("rb") as stream, target.open("wb") as out:
        reader = make_reader(stream)
        writer = Writer(out, chunk_size=chunk_bytes, compression=compression, use_chunking=chunk_bytes > 0)
        writer.start("", "another program")
        camera, channels = writer.register_channel("/camera", "jpeg", 0), {}
        for number, (schema, channel, message) in enumerate(reader.iter_messages()):
            if channel.id not in channels:
                known = writer.register_schema(schema.name, schema.encoding, schema.data) if schema else 0
                channels[channel.id] = writer.register_channel(channel.topic, channel.message_encoding, known)
            writer.add_message(channels[channel.id], message.log_time, message.data, message.publish_time)
            if number % 50 == 9:
                writer.add_message(camera, message.log_time, np.random.default_rng(1).bytes(200_000), 0)
        for each in reader.iter_attachments():
            writer.add_attachment(each.create_time, each.log_time, each.name, each.media_type, each.data)
        writer.add_attachment(0, 0, "part.jpg", "image/jpeg", bytes(9000))
        for each in reader.iter_metadata():
            writer.add_metadata(each.name, each.metadata)
        writer.finish()
    return target


@pytest.fixture(scope="module")
def ours(tmp_path_factory):
    file = tmp_path_factory.mktemp("ours") / "run.mcap"
    recording = begun(file)
    for part in np.array_split(some_rows(42, 4000), 8):
        recording.append(part, slots(1))
    recording.close()
    return file


@pytest.mark.parametrize("compression", CompressionType)
@pytest.mark.parametrize("chunk_bytes", [5_000, 150_000, 10_000_000])
def test_the_rows_are_the_same(ours, tmp_path, compression, chunk_bytes):
    again = open_telemetry(written_again(ours, tmp_path / "again.mcap", compression, chunk_bytes))
    rows = np.concatenate(list(open_telemetry(ours).rows()))
    assert np.concatenate(list(again.rows())).tobytes() == rows.tobytes()
    assert np.concatenate([piece(["cycle"])["cycle"] for piece in again.pieces()]).tolist() == rows["cycle"].tolist()
    run = RecordedRun(again)
    assert (run.cell.rows, run.unread, run.cell.lost) == (4000, [], 0)


def published(file, topics, encoding="json", **options):
    """Messages of other programs: (log time in ns, what it says) by topic."""
    with file.open("wb") as out:
        writer = Writer(out, **options)
        writer.start("", "another program")
        for topic, messages in topics.items():
            channel = writer.register_channel(topic, encoding, 0)
            for at_ns, told in messages:
                writer.add_message(channel, at_ns, json.dumps(told).encode(), at_ns)
        writer.finish()
    return file


def test_messages_of_json_are_columns(tmp_path):
    """Time since the first message of all, fields within fields, a message that lacks one; text is left out."""
    stage = [(5_000_000_000 + 100_000 * k, {"x": {"um": k}, "ends": [k, True], "name": "x"}) for k in range(50)]
    stage[7][1].pop("x")
    published(tmp_path / "j.mcap", {"/stage": stage, "/spindle": [(4_999_000_000, {"rpm": 9.5})]})
    table = read_table(tmp_path / "j.mcap")
    assert set(table) == {
        "/stage.log_time",
        "/stage.x.um",
        "/stage.ends[0]",
        "/stage.ends[1]",
        "/spindle.log_time",
        "/spindle.rpm",
    }
    np.testing.assert_allclose(table["/stage.log_time"], 1e-3 + 1e-4 * np.arange(50), rtol=1e-9)
    assert np.isnan(table["/stage.x.um"][7])
    assert table["/stage.ends[0]"].tolist() == list(range(50))
    stage.pop(7)
    published(tmp_path / "k.mcap", {"/stage": stage[:7], "/spindle": []})
    taken = take(tmp_path / "k.mcap", Wanted(["um", "/stage.ends[0]"]))
    assert (taken.step_s, taken.values[:, 0].tolist()) == (pytest.approx(1e-4), list(range(7)))


@pytest.mark.parametrize(
    ("topics", "options", "says"),
    [
        (
            {"/a": [(0, {"u": 1})], "/b": [(0, {"y": 1})]},
            {},
            "/a.u and /b.y are of different topics",
        ),
        (
            {"/a": [(0, {"u": "x"})]},
            {},
            r"nor messages of JSON with numbers in it; it has /a \(json without numbers\)",
        ),
        (
            {"/pose": [(0, 1)], "/tf": [(0, 1)]},
            {"encoding": "cdr"},
            r"it has /pose \(cdr\), /tf \(cdr\)\.",
        ),
        ({"/a": [(0, {"uu": 1, "y": 1})]}, {}, "there is no column u; its columns are /a.log_time, /a.uu, /a.y"),
    ],
)
def test_what_is_no_recording_is_told(tmp_path, topics, options, says):
    file = published(tmp_path / "foreign.mcap", topics, **options)
    with pytest.raises(CheckFailed, match=f"foreign.mcap: .*{says}"):
        take(file, Wanted(["u", "y"]))


@pytest.mark.parametrize("share", [0.0, 0.5, 0.999])
def test_one_that_is_cut_off_is_told_to_be_so(tmp_path, share):
    with (tmp_path / "bench.mcap").open("wb") as out:
        writer = Writer(out, compression=CompressionType.NONE)
        writer.start("", "another program")
        bench = writer.register_channel("/bench", "json", 0)
        for k in range(50):
            writer.add_message(bench, k * 1_000_000, json.dumps({"u": k}).encode(), 0)
        writer.finish()
    content = (tmp_path / "bench.mcap").read_bytes()
    assert read_table(tmp_path / "bench.mcap")["/bench.u"].tolist() == list(range(50))
    (tmp_path / "cut.mcap").write_bytes(content[: max(8, int(share * len(content)))])
    with pytest.raises(CheckFailed, match=r"cut\.mcap: it is cut off, damaged, or no MCAP"):
        read_table(tmp_path / "cut.mcap")
