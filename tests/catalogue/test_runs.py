"""Files found again: of each kind, by each question, when they change, and when they are damaged or somebody else's."""

import json
import os
import shutil
import sqlite3
import threading
from concurrent.futures import ThreadPoolExecutor
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pytest

from micromanip.catalogue.describing import described
from micromanip.catalogue.store import Catalogue, Query
from micromanip.errors import CheckFailed
from micromanip.faults import KINDS
from micromanip.host.trips.store import file_name
from tests.cli.command import code_of
from tests.design.test_run_figures import recording
from tests.host.boxes import box

CONFIG = Path(__file__).parents[2] / "config"
REPORT = """<html><script type="application/json" id="findings">{}</script></html>"""


def report(file, passed):
    criteria = [
        {"axis": "x", "name": f"criterion {i}", "passed": each, "value": "", "limit": ""}
        for i, each in enumerate(passed)
    ]
    findings = {"when": "2026-05-01T12:00:00+02:00", "criteria": {"x": criteria}, "hashes": {"x": "0123456789abcdef"}}
    file.write_text(REPORT.format(json.dumps(findings)))


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """A folder with two recordings, a trip, a report and a tuning, and what others keep there."""
    folder = tmp_path_factory.mktemp("runs")
    recording(folder / "good.mcap", amplitude=0.25)
    (folder / "deeper").mkdir()
    recording(folder / "deeper" / "bad.mcap", amplitude=2.0, fault=3, marks=["coolant off"])
    tripped = box()
    tripped.save(folder / file_name(tripped.meta["utc_ns"], "X-201", "x"))
    report(folder / "report.html", [True, True, False])
    shutil.copy(CONFIG / "simulated.yaml", folder / "tuned.yaml")
    (folder / "notes.txt").write_text("of somebody")
    (folder / "index.html").write_text("<html>of somebody</html>")
    (folder / "other.yaml").write_text("services: {}\n")
    np.savez(folder / "theirs.npz", a=np.zeros(3))
    (folder / ".hidden.mcap").write_bytes((folder / "good.mcap").read_bytes())
    (folder / "link.mcap").symlink_to(folder / "good.mcap")
    return folder


@pytest.fixture(scope="module")
def catalogue(made, tmp_path_factory):
    with Catalogue(tmp_path_factory.mktemp("catalogue") / "catalogue.sqlite") as opened:
        opened.refresh([made])
        yield opened


def names(catalogue, **query):
    return [entry.path.name for entry in catalogue.find(Query(**query))]


def test_each_kind_says_what_it_is_about(catalogue, made):
    found = {entry.path.name: entry for entry in catalogue.find(Query())}
    trip = next(name for name in found if name.endswith(".npz"))
    assert found.keys() == {"good.mcap", "bad.mcap", trip, "report.html", "tuned.yaml"}
    bad = found["bad.mcap"]
    assert bad.rms_um["x"] == pytest.approx(2.0, rel=1e-3)
    assert bad.seconds == pytest.approx(2.0, rel=1e-3)
    assert bad.faults == (KINDS[3].code,)
    assert "coolant off" in bad.about
    assert bad.problem == ""
    assert found[trip].faults == ("X-201",)
    assert found[trip].began == "2026-03-14T10:15:02+00:00"
    assert found["report.html"].began == "2026-05-01T10:00:00+00:00"  # all times in one zone: they are compared as text
    assert "2 of 3 criteria; not met: x: criterion 2" in found["report.html"].about
    assert "axis x commissioned" in found["tuned.yaml"].about
    assert catalogue.count() == 5


@pytest.mark.parametrize(
    ("query", "wanted"),
    [
        ({"kind": "recording", "sort": "worst"}, ["bad.mcap", "good.mcap"]),
        ({"above_um": 0.5}, ["bad.mcap"]),
        ({"text": "COOLANT"}, ["bad.mcap"]),
        ({"text": "deeper/"}, ["bad.mcap"]),
        ({"configuration": "0123456"}, ["report.html"]),
        ({"kind": "trip", "fault": "X-20"}, []),  # a fault is a whole one
        ({"since": "2026-05-01", "until": "2026-05-01"}, ["report.html"]),
        ({"until": "2026-04"}, ["20260314T101502.250Z_X-201_x.npz"]),
        ({"kind": "trip", "fault": "X-201"}, ["20260314T101502.250Z_X-201_x.npz"]),
        ({"text": "'; DROP TABLE entries; --"}, []),
        ({"sort": "oldest", "most": 1}, ["20260314T101502.250Z_X-201_x.npz"]),
    ],
)
def test_every_question_finds_what_it_asks_for(catalogue, query, wanted):
    assert names(catalogue, **query) == wanted
    assert catalogue.count() == 5


def test_other_usual_endings_are_looked_into_too(made, tmp_path):
    shutil.copy(made / "good.mcap", tmp_path / "GOOD.MCAP")
    shutil.copy(CONFIG / "simulated.yaml", tmp_path / "cell.yml")
    with Catalogue(tmp_path / "catalogue.sqlite") as catalogue:
        catalogue.refresh([tmp_path])
        kinds = {entry.path.name: entry.kind for entry in catalogue.find(Query())}
    assert kinds == {"GOOD.MCAP": "recording", "cell.yml": "tuning"}


def test_only_what_has_changed_is_read_again_and_what_is_gone_is_forgotten(made, tmp_path):
    folder = tmp_path / "copy"
    shutil.copytree(made, folder, symlinks=True)
    with Catalogue(tmp_path / "catalogue.sqlite") as catalogue:
        read = []
        catalogue.refresh([folder], read.append)
        assert folder / "good.mcap" in read
        assert folder / "notes.txt" not in read
        read.clear()
        catalogue.refresh([folder, folder / "deeper"], read.append)
        assert read == []
        report(folder / "report.html", [True])
        (folder / "good.mcap").unlink()
        catalogue.refresh([folder], read.append)
        assert read == [folder / "report.html"]
        assert "1 of 1 criteria" in next(iter(catalogue.find(Query(kind="report")))).about
        assert "good.mcap" not in names(catalogue)
        catalogue.add(folder)
        assert catalogue.drop(folder)
        assert catalogue.count() == 0
        assert not catalogue.drop(folder)


def test_damaged_files_are_listed_with_what_is_wrong(made, tmp_path):
    whole = (made / "good.mcap").read_bytes()
    (tmp_path / "cut.mcap").write_bytes(whole[: len(whole) // 2])
    (tmp_path / "empty.mcap").write_bytes(b"")
    (tmp_path / "20260314T101502.250Z_X-201_x.npz").write_bytes(b"PK\x03\x04 nonsense")
    found = {path.name: described(path) for path in sorted(tmp_path.iterdir())}
    assert found["cut.mcap"].problem == "not ended in order"
    assert found["empty.mcap"].problem
    assert "damaged" in found["20260314T101502.250Z_X-201_x.npz"].problem
    changed = datetime.fromisoformat(found["empty.mcap"].began)
    assert abs((datetime.now(UTC) - changed).total_seconds()) < 600


@pytest.mark.parametrize("content", [b"not a catalogue at all, but something long enough to be one" * 20, None])
def test_what_is_no_catalogue_of_ours_is_not_touched(tmp_path, content):
    file = tmp_path / "catalogue.sqlite"
    if content is None:
        with sqlite3.connect(file) as base:
            base.execute("CREATE TABLE of_somebody (a)")
        base.close()
        content = file.read_bytes()
    else:
        file.write_bytes(content)
    with pytest.raises(CheckFailed, match=r"catalogue\.sqlite: .*remove it"):
        Catalogue(file)
    assert file.read_bytes() == content


def test_the_command_lists_answers_and_makes_a_page(made, tmp_path, capsys, monkeypatch):
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    page = tmp_path / "runs.html"
    assert code_of("runs", "--add", made, "--json", "--page", page) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["entries"] == 5
    assert {Path(entry["path"]).name for entry in told["found"]} >= {"good.mcap", "tuned.yaml"}
    assert "coolant off" in page.read_text()
    assert code_of("runs", "--page", page) == 64
    assert code_of("runs", "--kind", "recording", "--sort", "worst") == 0
    shown = capsys.readouterr().out
    assert shown.index("bad.mcap") < shown.index("good.mcap")
    assert "2 of 5" in shown
    for slip, words in ((["--since", "yesterday"], "expected a date"), (["--fault", "X-2O1"], "did you mean X-2")):
        assert code_of("runs", *slip) == 64
        assert words in capsys.readouterr().err
    assert code_of("runs", "--drop", tmp_path / "elsewhere") == 64
    assert "is not looked through; these are: " in capsys.readouterr().err


def test_days_of_a_trend_are_found_and_how_a_figure_went(tmp_path, capsys, monkeypatch):
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    days = tmp_path / "days"
    days.mkdir()
    head = "time,seconds,cycles,overruns,link_down_cycles,state,fault,error_um_x_rms,error_um_y_rms"
    for day, error in (("2026-11-01", 0.3), ("2026-11-02", 0.4)):
        rows = [f"{day}T10:0{k}:00,{20 * (k + 1)},1,0,0,7,{3 * k},{error + k},0.1" for k in range(2)]
        (days / f"{day}-minutes.csv").write_text("\n".join([head, *rows]) + "\n")
        (days / f"{day}-seconds.csv").write_text(f"{head}\n")
    (days / "2026-11-03-minutes.csv").write_text(f"{head}\nsoon\n")
    (days / "others.csv").write_text("a,b\n1,2\n")

    assert code_of("runs", "--trend", "error_um") == 1
    assert "no trend was found; `trend: {}` in the configuration keeps one" in capsys.readouterr().err
    assert code_of("runs", "--add", days, "--kind", "trend", "--json") == 0
    damaged, *found = json.loads(capsys.readouterr().out)["found"]
    assert "minutes.csv:2: this row has 1 values, the head 9" in damaged["problem"]
    assert [entry["began"] for entry in found] == ["2026-11-02T10:00:00+00:00", "2026-11-01T10:00:00+00:00"]
    assert [entry["seconds"] for entry in found] == [60.0, 60.0]
    rms = {"x": pytest.approx(np.sqrt((0.4**2 + 2 * 1.4**2) / 3), rel=1e-5), "y": 0.1}
    assert (found[0]["rms_um"], found[0]["faults"]) == (rms, [KINDS[3].code])

    (days / "2026-11-03-minutes.csv").unlink()
    page = tmp_path / "page.html"
    assert code_of("runs", "--trend", "error_um_x", "--until", "2026-11-01", "--json", "--page", page) == 0
    ((trend,), text) = json.loads(capsys.readouterr().out)["trends"], page.read_text()
    assert (trend["folder"], trend["from"], trend["to"]) == (str(days), "2026-11-01T10:00:00", "2026-11-01T10:01:00")
    assert [(each["field"], each["last"]) for each in trend["courses"]] == [("error_um_x_rms", 1.3)]
    assert "Trend of error_um_x" in text
    assert "<svg" in text
    assert code_of("runs", "--trend", "eror_um") == 64
    assert "there is no column eror_um; did you mean" in capsys.readouterr().err


@pytest.mark.skipif(os.geteuid() == 0, reason="root may read everything")
def test_what_may_not_be_read_is_passed_over(made, tmp_path):
    file = tmp_path / "closed.mcap"
    shutil.copy(made / "good.mcap", file)
    file.chmod(0)
    with Catalogue(tmp_path / "catalogue.sqlite") as catalogue:
        catalogue.refresh([tmp_path])
        assert catalogue.find(Query())[0].problem


def test_many_may_make_it_at_once(tmp_path):
    begin = threading.Barrier(8)

    def opened(_):
        begin.wait(10)
        with Catalogue(tmp_path / "catalogue.sqlite") as catalogue:
            return catalogue.count()

    with ThreadPoolExecutor(8) as threads:
        assert list(threads.map(opened, range(8))) == [0] * 8
