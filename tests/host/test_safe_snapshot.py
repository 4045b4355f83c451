"""What a run leaves for ``park``, whom it is believed from, and what is used in its place."""

import asyncio
import base64
import json
import os
import shutil
import zlib
from pathlib import Path

import pytest

from campaigns.report import CONFIG
from micromanip.errors import ConfigError
from micromanip.host.safe import plan as safe_plan
from micromanip.host.safe import snapshot as safe_snapshot
from micromanip.host.safe.plan import plan_of
from micromanip.host.safe.snapshot import NotUsable, SnapshotService, path_of, read, write
from micromanip.settings.check import prepare
from micromanip.settings.text.source import Source
from tests.cells import SLOW, changed

OURS = {0, os.geteuid()}
PARKED = changed(SLOW, ("park_V: 0", "park_V: 5"))
BAD = changed(SLOW, ("park_V: 0", "park_V: 151"))


@pytest.fixture
def config(tmp_path, monkeypatch):
    """A configuration, and a state directory of its own."""
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    monkeypatch.setattr(safe_plan, "SERVICE_STATE", tmp_path / "service")
    file = tmp_path / "cell.yaml"
    file.write_text(SLOW)
    return file


@pytest.fixture
def folder(tmp_path):
    return tmp_path / "state" / "micromanip"


def kept(config, folder, files=None):
    """The file of a snapshot of `config` as it is now."""
    write(Source.read(config), files or {}, folder)
    return path_of(config, folder)


def test_what_was_written_is_read(config, folder):
    path = kept(config, folder)
    snapshot = read(config, folder, OURS)
    assert snapshot.source.data == Source.read(config).data
    assert snapshot.source.path == config
    assert snapshot.file == path
    assert snapshot.taken.endswith("Z")
    assert [file.name for file in path.parent.iterdir()] == [path.name], "nothing is left of the writing"
    assert read(config.with_name("other.yaml"), folder, OURS) is None


def test_the_newest_counts_and_a_writer_that_was_killed_leaves_the_one_before(config, folder, monkeypatch):
    kept(config, folder)
    config.write_text(PARKED)
    with monkeypatch.context() as patch:
        patch.setattr(safe_snapshot.os, "rename", lambda *_, **__: (_ for _ in ()).throw(OSError(28, "disk full")))
        with pytest.raises(OSError, match="disk full"):
            kept(config, folder)
    assert plan_of(config).configuration.outputs["voltage_x"].park_V == 0
    assert len(list((folder / "park").iterdir())) == 1
    kept(config, folder)
    assert plan_of(config).configuration.outputs["voltage_x"].park_V == 5


def foreign(path):
    os.chown(path, 4711, 4711)


def linked(path):
    shutil.copy(path, path.with_suffix(".copy"))
    path.unlink()
    path.symlink_to(path.with_suffix(".copy"))


def linked_folder(path):
    path.parent.rename(path.parent.with_name("elsewhere"))
    path.parent.symlink_to("elsewhere")


def edited(change):
    def edit(path):
        document = json.loads(path.read_text())
        change(document)
        path.write_text(json.dumps(document))

    return edit


def nested(depth):
    value = {}
    for _ in range(depth):
        value = {"drivers": value}
    return value


BOMB = base64.b64encode(zlib.compress(bytes(21_000_000))).decode()
SPOILT = {
    "of another user": (foreign, "belongs to user 4711"),
    "in a folder of another user": (lambda path: foreign(path.parent), "belongs to user 4711"),
    "writable by the group": (lambda path: path.chmod(0o660), "can be written by others"),
    "writable by all": (lambda path: path.chmod(0o606), "can be written by others"),
    "in a folder that is writable by all": (lambda path: path.parent.chmod(0o1777), "can be written by others"),
    "a link": (linked, "can't be read"),
    "in a folder that is a link": (linked_folder, "can't be read"),
    "with a second name": (lambda path: os.link(path, path.with_suffix(".2")), "is no plain file"),
    "a pipe": (lambda path: (path.unlink(), os.mkfifo(path)), "is no plain file"),
    "cut off": (lambda path: path.write_text(path.read_text()[:-20]), "is damaged"),
    "not a document": (lambda path: path.write_text("[1, 2]"), "is damaged"),
    "without its configuration": (edited(lambda d: d.pop("document")), "is damaged"),
    "endless": (lambda path: path.write_text(" " * 32_000_001), "larger than 32 MB"),
    "nested without end": (lambda path: path.write_text("[" * 100_000 + "]" * 100_000), "is damaged"),
    "with a document that is nested deep": (edited(lambda d: d.update(document=nested(200))), "is damaged"),
    "with a file that unpacks without end": (edited(lambda d: d.update(files={"/a": BOMB})), "is damaged"),
    "of another format": (edited(lambda d: d.update(format=1)), "is not a snapshot of"),
    "of another configuration": (edited(lambda d: d.update(configuration="/etc/other.yaml")), "is not a snapshot of"),
    "with a value that was tampered with": (
        edited(lambda d: d["document"]["outputs"]["voltage_x"].update(park_V=400)),
        "park_V",
    ),
}


@pytest.mark.parametrize("how", SPOILT)
def test_a_snapshot_that_cannot_be_believed_is_not_used(config, folder, how):
    spoil, why = SPOILT[how]
    spoil(kept(config, folder))
    config.write_text(PARKED)
    plan = plan_of(config)
    assert (plan.taken, plan.file) == (None, config), "the file itself, which would be let run"
    assert plan.configuration.outputs["voltage_x"].park_V == 5
    assert [why in warning for warning in plan.warnings] == [True]
    config.write_text(BAD)
    with pytest.raises(ConfigError, match="nothing was touched") as refused:
        plan_of(config)
    assert why in str(refused.value)


def test_a_typing_error_in_the_file_changes_nothing(config, folder):
    path = kept(config, folder)
    for text in (BAD, changed(SLOW, ("outputs:", "outptus:")), "{", None):
        if text is None:
            config.unlink()
        else:
            config.write_text(text)
        plan = plan_of(config)
        assert plan.configuration.outputs["voltage_x"].park_V == 0
        assert plan.said == f"as of the run of {read(config, folder, OURS).taken} ({path})"
        assert plan.warnings == []


def test_with_neither_nothing_is_done(config):
    config.write_text(BAD)
    with pytest.raises(ConfigError) as refused:
        plan_of(config)
    first, last = str(refused.value).splitlines()
    assert first.startswith(f"{config}:7: outputs.voltage_x")
    assert last.startswith("nothing was touched: the file can't be used, and no run has left a snapshot that can be")
    assert "(there is none)" in last
    assert f"micromanip check {config}" in last


def test_the_file_is_held_to_all_that_run_asks(config):
    config.write_text(changed(SLOW, ("{source: hold, offset_um: 60}", "{source: hold, offset_um: 600}")))
    with pytest.raises(ConfigError, match="can't reach it"):
        plan_of(config)


def test_the_services_own_state_is_believed_from_whom_the_service_is(config, tmp_path):
    service = tmp_path / "service"
    path = kept(config, service)
    for each in (service, path.parent, path):
        os.chown(each, 4711, 4711)
    assert plan_of(config).file == path
    foreign(path)
    os.chown(service, 4712, 4712)
    assert plan_of(config).taken is None, "not what somebody else has put there"
    os.chown(service, 4711, 4711)
    tmp_path.chmod(0o777)
    assert plan_of(config).taken is None, "nor where anybody can put another folder in its place"


def frame(plan):
    """Bytes of each message with 1 on all outputs."""
    (bridge,) = plan.wiring.buses.values()
    return [bytes(each.frame([1.0] * len(bridge.bus.outputs)).data) for each in bridge.bus._sent]


def edit_database(file):
    text = file.read_text()
    file.write_text(text.replace("(0.00275,-22)", "(0.003,-22)"))


def replace_by_pipe(file):
    file.unlink()
    os.mkfifo(file)


def replace_by_endless(file):
    file.unlink()
    file.symlink_to("/dev/zero")


@pytest.mark.parametrize("change", [edit_database, replace_by_pipe, replace_by_endless, Path.unlink])
def test_a_message_database_is_used_as_it_was_when_it_last_ran(tmp_path, monkeypatch, change):
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    monkeypatch.setattr(safe_plan, "SERVICE_STATE", tmp_path / "service")
    shutil.copytree(CONFIG / "can", tmp_path / "can")
    for name, database in (("can.yaml", "can/manipulator.dbc"), ("canopen.yaml", "can/amplifier.eds")):
        config = tmp_path / name
        shutil.copy(CONFIG / name, config)
        warnings = []
        keeper = SnapshotService(prepare(config), tmp_path / "micromanip", warnings.append)
        asyncio.run(keeper.keep(Source.read(config)))
        assert warnings == []
        before = frame(plan_of(config))
        change(tmp_path / database)
        plan = plan_of(config)
        assert (plan.taken is None, plan.warnings) == (False, [])
        assert frame(plan) == before


def test_a_clock_that_was_wrong_makes_no_snapshot_newer(config, folder, tmp_path):
    old = kept(config, tmp_path / "service")
    document = json.loads(old.read_text())
    config.write_text(PARKED)
    kept(config, folder)
    for boot in (document["boot"], "an earlier start"):
        old.write_text(json.dumps(document | {"taken": "2099-01-01T00:00:00.000Z", "boot": boot}))
        assert plan_of(config).configuration.outputs["voltage_x"].park_V == 5


def test_of_earlier_starts_of_the_machine_the_later_run_counts(config, folder, tmp_path):
    paths = [kept(config, tmp_path / "service"), kept(config, folder)]
    for path, run in zip(paths, (8, 7), strict=True):
        path.write_text(json.dumps(json.loads(path.read_text()) | {"boot": "an earlier one", "run": run}))
    assert plan_of(config).file == paths[0]
    kept(config, folder)
    assert plan_of(config).file == paths[1]
    assert json.loads(paths[1].read_text())["run"] == 8


def revised(config, *changes):
    """The document of `config` with (key, value) changed in voltage_x."""
    source = Source.read(config)
    document = json.loads(json.dumps(source.data))
    document["outputs"]["voltage_x"].update(changes)
    return Source.of(document, config)


def test_the_keeper_follows_what_concerns_the_outputs(config, folder, monkeypatch):
    written = []
    monkeypatch.setattr(safe_snapshot, "write", lambda *a: (written.append(a[0]), write(*a)))

    async def life():
        keeper = SnapshotService(prepare(config), folder, pytest.fail)
        await keeper.keep(Source.read(config))
        jogged = Source.of(Source.read(config).data | {"reference": {"source": "hold", "offset_um": 61}}, config)
        keeper.follow(jogged)
        await keeper.settle()
        assert len(written) == 1, "no write to the disk for each jog"
        keeper.follow(revised(config, ("slew_V_per_ms", 20)))
        keeper.follow(revised(config, ("slew_V_per_ms", 10)))
        await keeper.settle()

    asyncio.run(life())
    assert plan_of(config).configuration.outputs["voltage_x"].slew_V_per_ms == 10


@pytest.mark.parametrize("spoil", [lambda folder: folder.write_text(""), foreign])
def test_a_snapshot_that_cannot_be_written_is_a_warning(config, folder, spoil):
    folder.mkdir(parents=True)
    target = folder / "park"
    if spoil is foreign:
        target.mkdir()
    spoil(target)
    warnings = []
    asyncio.run(SnapshotService(prepare(config), folder, warnings.append).keep(Source.read(config)))
    assert len(warnings) == 1
    assert warnings[0].startswith(f"WARNING: no snapshot for `micromanip park` in {folder}: ")


def test_others_may_read_it_and_not_write_it(config, folder):
    path = kept(config, folder)
    assert path.stat().st_mode & 0o022 == 0
    with pytest.raises(NotUsable):
        read(config, folder, {4711})
