"""Many tunings on a recording: what is drawn, the same table wherever it is computed, a configuration that passes."""

import json
import os
import signal

import pytest
from cli.command import code_of
from hypothesis import given
from hypothesis import strategies as st

from micromanip.design import parallel
from micromanip.errors import UsageError
from micromanip.replay.variation import Variation, drawn
from micromanip.settings.check import prepare

WEIGHT, GAIN = "axes.*.outer.control_weight", "axes.x.inner.K_V_per_um"
VARIED = ("--vary", f"{WEIGHT}=0.5..50:log", "--vary", f"{GAIN}=0.1..2", "--cut", "5.5:6.2")


@given(st.integers(0, 2**32 - 1), st.integers(1, 300))
def test_values_lie_in_their_range_and_follow_from_seed_and_number(seed, count):
    variations = [Variation.parse("k=2..200:log"), Variation.parse("m=-1..1"), Variation.parse("n=3,5,7")]
    found = drawn(variations, count, seed)
    assert len(found) == count
    for values in found:
        assert 2.0 <= values["k"] <= 200.0
        assert -1.0 <= values["m"] <= 1.0
        assert values["n"] in (3.0, 5.0, 7.0)
    assert found == drawn(variations, count + 1, seed)[:count]


@pytest.mark.parametrize(
    "text", ["k", "k=", "k=2..1", "k=1..x", "=1..2", "k=1..2:lin", "k=nan..2", "k=0..1:log", "k=1,y"]
)
def test_what_is_no_range_is_refused(text):
    with pytest.raises(UsageError, match=f"--vary '{text}'"):
        Variation.parse(text)


@pytest.fixture(scope="module")
def on_one_machine(recorded, tmp_path_factory):
    """What the command says with one process, and its file."""
    best = tmp_path_factory.mktemp("best") / "best.yaml"
    return best, answer(recorded, "--jobs", 1, "--trials", 60, "--best", 60, "--to", best)


def answer(recorded, *more):
    import contextlib
    import io

    out = io.StringIO()
    with contextlib.redirect_stdout(out):
        assert code_of("replay", recorded[1].file, *VARIED, *more, "--json") == 0
    return json.loads(out.getvalue())


@pytest.mark.compiled_only
@pytest.mark.long
def test_the_best_configuration_passes_the_check(recorded, on_one_machine, capsys):
    best, document = on_one_machine
    costs = [trial["cost_um"] for trial in document["best"]]
    assert costs == sorted(costs)
    assert (document["base"]["number"], document["base"]["values"]) == (0, {})
    assert document["refused"] > 0, "a gain of 1.5 V/um passes no check"
    assert len(document["best"]) == 61 - document["refused"] - document["stopped"]
    chosen = document["best"][0]
    assert document["written"] == str(best)
    found = prepare(best).configuration
    assert {axis.outer.control_weight for axis in found.axes.values()} == {chosen["values"][WEIGHT]}
    assert found.axes["x"].inner.K_V_per_um == chosen["values"][GAIN]
    assert f"{chosen['cost_um']:.4f} um" in best.read_text()
    assert code_of("check", best) == 0
    assert code_of("replay", recorded[1].file, "--with", best, "--cut", "5.5:6.2", "--json") == 0


@pytest.mark.compiled_only
@pytest.mark.live
@pytest.mark.filterwarnings("ignore")  # a worker that is killed closes nothing
def test_a_scheduler_gives_the_same_table_though_a_worker_is_killed(recorded, on_one_machine, monkeypatch):
    distributed = pytest.importorskip("distributed")
    killed = []

    def killing(*given, **more):
        with distributed.Client(local.scheduler_address) as client:
            for count, result in enumerate(each(*given, **more)):
                if count == 20:
                    killed.append(next(iter(client.run(os.getpid).values())))
                    os.kill(killed[0], signal.SIGKILL)
                yield result

    each = parallel.each
    monkeypatch.setattr(parallel, "each", killing)
    local = distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, processes=True, dashboard_address=None, host="127.0.0.1", protocol="tcp"
    )
    with local:
        found = answer(recorded, "--scheduler", local.scheduler_address, "--trials", 60, "--best", 60)
        with distributed.Client(local.scheduler_address) as client:
            assert killed[0] not in client.run(os.getpid).values()
    assert found | {"written": None} == on_one_machine[1] | {"written": None}


@pytest.mark.compiled_only
@pytest.mark.long
@pytest.mark.parametrize(
    ("given", "code", "says"),
    [
        (("--vary", "axes.x.inner.Tii_ms=1..2"), 64, "axes.x.inner.Tii_ms; did you mean axes.x.inner.Ti_ms?"),
        (("--vary", "axes.x.mode=1..2"), 64, "it is stage; only numbers can be varied"),
        (("--vary", "axes.x.inner=1..2"), 64, "it is a section"),
        (("--vary", "loop.rate_hz=9000..10000"), 64, "only axes and reference are a tuning"),
        (("--vary", f"{GAIN}=1..2", "--vary", f"{GAIN}=1..3"), 64, "is given twice"),
        (("--vary", f"{GAIN}=1..2", "--cut", "0:1"), 1, "no piece of 0.5 s tracks in it from 0 to 1 s"),
        (("--trials", 3), 64, "--trials goes with --vary"),
        (("--vary", f"{GAIN}=1..2", "--scheduler", "nonsense://x"), 69, "no Dask scheduler answers at nonsense:"),
    ],
)
def test_what_cannot_be_varied_is_one_message(recorded, tmp_path, capsys, given, code, says):
    assert code_of("replay", recorded[1].file, *given) == code
    (line,) = [line for line in capsys.readouterr().err.splitlines() if line.startswith("micromanip: ")]
    assert says in line
