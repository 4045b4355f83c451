"""When a machine is called ready, and the command that says so."""

import contextlib
import dataclasses
import json
import os

import numpy as np
import pytest

from micromanip.cli.main import main
from micromanip.errors import CheckFailed
from micromanip.host.readiness import timed
from micromanip.host.readiness.answer import Answer
from micromanip.host.readiness.finding import Finding, Verdict
from micromanip.host.readiness.loop_run import LoopRun
from micromanip.rt.mailbox import BINS
from micromanip.settings.schema.model import Loop

RUN = LoopRun(np.zeros(BINS, np.int64), np.zeros(BINS, np.int64), 0, 0, 10_000, 0, ())


def answer(*verdicts, at_rest=RUN, under_load=RUN):
    run = timed.Timed(1.0, 2, at_rest, under_load)
    findings = tuple(Finding(f"setting {i}", verdict, "", "") for i, verdict in enumerate(verdicts))
    return Answer({}, findings, run)


def test_ready_is_what_missed_no_deadline_and_has_nothing_bad():
    good = answer(Verdict.GOOD, Verdict.UNKNOWN, Verdict.POOR)
    assert good.ready is True
    assert good.verdict == (
        "READY for the 1 s that were measured: 0 overruns in 10000 cycles at rest, 0 in 10000 under load; "
        "1 settings are poor, and may show in a longer run"
    )


@pytest.mark.parametrize(
    ("found", "words"),
    [
        (answer(Verdict.BAD), "NOT READY: setting 0"),
        (answer(under_load=dataclasses.replace(RUN, overruns=1)), "1 in 10000 under load"),
        (answer(at_rest=dataclasses.replace(RUN, overruns=3)), "3 overruns in 10000 cycles at rest"),
        (answer(under_load=dataclasses.replace(RUN, refused=("no SCHED_FIFO: advice",))), "NOT READY: no SCHED_FIFO"),
    ],
)
def test_one_thing_is_enough_for_not_ready(found, words):
    assert found.ready is False
    assert words in found.verdict


@pytest.mark.parametrize("module", ["micromanip.host.loop_process", "micromanip.bus.worker_process"])
def test_beside_a_controller_nothing_is_run(tmp_path, module):
    process = tmp_path / "proc" / "4711"
    process.mkdir(parents=True)
    (process / "cmdline").write_bytes(b"python3\0-P\0-m\0some.other.module\0")
    timed.refuse_beside_a_controller(tmp_path)
    (process / "cmdline").write_bytes(b"/opt/micromanip/bin/python3\0-P\0-m\0" + module.encode() + b"\0")
    with pytest.raises(CheckFailed, match=r"a controller runs here \(process 4711\).*--no-run"):
        timed.refuse_beside_a_controller(tmp_path)


def test_the_settings_alone_as_json(capsys):
    with contextlib.suppress(SystemExit):  # as an ordinary user it is not ready
        main(["system", "check", "--no-run", "--json"])
    document = json.loads(capsys.readouterr().out)
    assert document["timed"] is None
    assert document["ready"] is (False if any(f["verdict"] == "bad" for f in document["findings"]) else None)
    assert document["machine"]["loop"]["cpu"] == max(os.sched_getaffinity(0))


@pytest.mark.live
def test_the_loop_is_run_and_every_cycle_is_counted(monkeypatch, capsys):
    monkeypatch.setattr(timed, "_CONTROLLERS", ())  # those of other tests, beside us
    asked_s = []
    monkeypatch.setattr(timed, "loaded", lambda longest_s: contextlib.nullcontext(asked_s.append(longest_s) or 2))
    found = timed.measure(Loop(cpu=max(os.sched_getaffinity(0)), limits="simulation", spin_us=20), 0.5, print)
    for run in (found.at_rest, found.under_load):
        assert run.cycles > 1000
        assert run.compute.sum() == pytest.approx(run.cycles, rel=0.01)  # read one after the other
        assert run.lateness_max_ns > 0
        assert run.compute_max_ns > 0
    assert json.loads(json.dumps(found.document()))["under_load"]["cycles"] == found.under_load.cycles
    said = capsys.readouterr().out.splitlines()
    assert "the loop beside 2 busy processes, 0.5 s" in said
    assert asked_s == [pytest.approx(121.0)], "the load outlasts the runs beside it"
    assert found.load_processes == 2
