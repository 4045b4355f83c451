"""Our messages as other programs save them again: other chunks, other compression, channels and files of their own."""

import numpy as np
import pytest
from host.test_mcap_recording import begun, slots, some_rows

pytest.importorskip("mcap")
from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer

from micromanip.design.recorded_run import RecordedRun
from micromanip.errors import CheckFailed
from micromanip.recordings import open_telemetry


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


def test_a_file_without_chunks_is_told_with_what_to_do(ours, tmp_path):
    file = written_again(ours, tmp_path / "flat.mcap", CompressionType.NONE, 0)
    with pytest.raises(CheckFailed, match=r"flat\.mcap: its messages are in no chunks; `mcap compress` writes a copy"):
        open_telemetry(file)
