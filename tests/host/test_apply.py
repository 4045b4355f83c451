"""`apply` on a running controller: in force, back again, refused, and taken back where it does not come."""

import json

import pytest

from campaigns.running_controller import until
from micromanip.client import Client
from tests.cells import LEISURELY, WAITING, changed
from tests.cli.command import code_of

pytestmark = pytest.mark.live  # a running controller

CALMER = ("K_V_per_um: 0.6", "K_V_per_um: 0.5")
ELSEWHERE = ("rate_hz: 200", "rate_hz: 250")
K = "axes.x.inner.K_V_per_um"


@pytest.fixture
def cell(run):
    cell = run(changed(LEISURELY, *WAITING)).reach("READY")
    yield cell
    cell.end()


@pytest.fixture
def apply(cell, capsys):
    """Exit code, the document, and what was said."""

    def typed(*arguments):
        capsys.readouterr()
        code = code_of("apply", *arguments, "--socket", cell.socket, "--yes", "--json")
        out, err = capsys.readouterr()
        return code, json.loads(out) if out else None, err

    return typed


def tuned(cell, *changes):
    file = cell.folder / "tuned.yaml"
    file.write_text(changed(changed(LEISURELY, *WAITING), *changes))
    return file


def running(cell):
    with Client(cell.socket) as client:
        return client.value(K)


def test_a_tuning_comes_into_force_and_goes_back(cell, apply):
    before = cell.config.read_text()
    code, done, _ = apply(tuned(cell, CALMER))
    assert code == 0
    assert [(each["key"], each["running"], each["new"]) for each in done["changed"]] == [(K, 0.6, 0.5)]
    assert running(cell) == 0.5
    assert cell.config.read_text() == tuned(cell, CALMER).read_text()
    code, done, _ = apply("--back")
    assert code == 0
    assert running(cell) == 0.6
    assert cell.config.read_text() == before


def test_what_takes_a_new_start_is_asked_for_a_unit(cell, apply):
    code, _, err = apply(tuned(cell, ELSEWHERE))
    assert code == 64
    assert "takes a new start: name the unit" in err
    assert "rate_hz: 200" in cell.config.read_text()


def test_a_file_that_does_not_come_into_force_is_taken_back(cell, apply):
    """There is no such unit: the file is as it was, and the controller runs on."""
    code, _, err = apply(tuned(cell, ELSEWHERE), "--service", "micromanip-nobody-has-this")
    assert code == 1
    assert "is as it was" in err
    assert "rate_hz: 200" in cell.config.read_text()
    assert list(cell.config.parent.glob("*.before-*")) == []
    until(lambda: cell.state == "READY", cell.last_words)


def test_a_wrong_file_touches_nothing(cell, apply):
    before, wrong = cell.config.read_text(), cell.folder / "tuned.yaml"
    wrong.write_text(before.replace("K_V_per_um: 0.6", "K_V_per_um: fast"))
    code, _, err = apply(wrong)
    assert code == 78
    assert err.startswith(f"micromanip: {wrong}:"), "the file that is to be mended"
    assert "inner.K_V_per_um" in err
    assert cell.config.read_text() == before


def test_one_of_file_and_back(apply):
    assert apply()[0] == 64
    assert apply("x.yaml", "--back")[0] == 64
    assert "nothing to put back" in apply("--back")[2]


def test_ctrl_c_while_it_is_waited_for_takes_it_back(cell, apply, monkeypatch):
    def interrupted(*_):
        raise KeyboardInterrupt

    before = cell.config.read_text()
    monkeypatch.setattr("micromanip.cli.apply.Applied._await", interrupted)
    code, _, err = apply(tuned(cell, CALMER))
    assert code != 0
    assert "is as it was" in err
    assert cell.config.read_text() == before
    assert running(cell) == 0.6
