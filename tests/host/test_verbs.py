"""Values changed while it runs: whole or not at all, each refusal with its reasons, everything noted."""

import contextlib
import re

import pytest

from micromanip.errors import CheckFailed, ConfigError, DeviceUnavailable, UsageError
from micromanip.rt import states
from micromanip.settings.check import prepare

from .standin import SIMULATED, Cell, jogging

K, TI, MODE, CENTRE = "axes.x.inner.K_V_per_um", "axes.x.inner.Ti_ms", "axes.x.mode", "axes.x.centre_um"


@pytest.fixture
def cell(tmp_path):
    return Cell(tmp_path)


@pytest.fixture
def jogged(tmp_path):
    return Cell(tmp_path, jogging())


def refused(cell, error, message, verb, **fields):
    """It is refused, in these words; nothing has changed, and the refusal is noted."""
    hash_before = cell.controller.prepared.source.hash
    swaps = len(cell.controller.swaps)
    with pytest.raises(error, match=re.compile(f"^{message}$", re.DOTALL)) as told:
        cell(verb, **fields)
    assert len(cell.controller.swaps) == swaps
    assert cell.controller.prepared.source.hash == hash_before
    assert cell.entries[-1][0] == verb
    assert cell.entries[-1][1] is False
    assert cell.entries[-1][3] == str(told.value)


def test_get(cell):
    inner = cell("get", keys=["axes.x.inner"])
    assert {p["key"]: p["value"] for p in inner}[K] == 0.6
    assert {p["change"] for p in inner} == {"live"}
    assert cell("get", keys=[MODE, "loop.rate_hz"]) == [
        {"key": "loop.rate_hz", "value": 10000, "change": "needs restart"},
        {"key": MODE, "value": "stage", "change": "needs disarm"},
    ]
    (age,) = cell("get", keys=["signals.true_strain_x.max_age_us"])
    assert (age["value"], age["computed"]) == (300.0, "three samples at 10000 Hz and 0 us on their way")
    assert len(cell("get")) > 150
    with pytest.raises(UsageError, match=r"^unknown key axes.x.iner; did you mean axes.x.inner\?$"):
        cell("get", keys=["axes.x.iner"])
    assert cell.entries == []


def test_set_is_one_swap(cell):
    swap = cell("set", changes={K: 0.5, "axes.y.inner.K_V_per_um": 0.4, "axes.x.setpoint.slew_um_per_ms": 10})
    assert swap["version"] == 2
    assert {c["key"]: (c["old"], c["new"]) for c in swap["changed"]} == {
        K: (0.6, 0.5),
        "axes.y.inner.K_V_per_um": (0.6, 0.4),
        "axes.x.setpoint.slew_um_per_ms": (20.0, 10.0),
    }
    assert len(cell.controller.swaps) == 1
    assert list(cell.controller.axes["pid"]["K_V_per_um"]) == [0.5, 0.4, 0.6]
    assert list(cell.controller.axes["setpoint_slew_um"]) == [1.0, 2.0, 2.0]
    assert cell.value(K) == 0.5
    verb, accepted, changes, reason = cell.entries[-1]
    assert (verb, accepted, reason) == ("set", True, None)
    assert changes[K] == (0.6, 0.5)


def test_hash_tells_the_configuration(cell):
    """Another one has another hash; back at the file's values, it is the file's again."""
    original = cell.controller.prepared.source.hash
    cell("set", changes={K: 0.5})
    assert cell.controller.prepared.source.hash != original
    cell("set", changes={K: 0.6})
    assert cell.controller.prepared.source.hash == original
    assert [source.hash for source in cell.told][1:] == [original]


WRONG = {
    "no such key": ({"axes.x.inner.Ti_s": 1}, r"axes.x.inner.Ti_s: unknown key Ti_s: did you mean Ti_ms \(.*\)\?"),
    "type": ({K: "fast"}, f"{K}: expected a number from 1e-09 to 1000000000, not the text 'fast'"),
    "range": ({K: -1}, f"{K}: expected a number from 1e-09 to 1000000000, not -1"),
    "rule": (
        {"axes.x.inner.mode": "pid", "axes.x.setpoint.range_um": [9, 3]},
        "axes.x.setpoint.range_um: range_um must rise.*",
    ),
    "unstable": ({"axes.x.outer.model.C": [0] * 6}, "axes.x.outer.model: its steady gain is 0; .*"),
    "two": ({K: -1, TI: 0}, f"{K}: expected a number .*\n{TI}: expected a number .*"),
    "beside a good one": ({K: 0.5, TI: -1}, f"{TI}: expected a number from 0.001 to 3600000, not -1"),
}


@pytest.mark.parametrize(("changes", "message"), WRONG.values(), ids=WRONG)
def test_wrong_value(cell, changes, message):
    refused(cell, ConfigError, message, "set", changes=changes)
    assert cell.value(K) == 0.6


@pytest.mark.parametrize("state", ["ARMING", "TRACKING", "HOLDING", "RAMPING"])
def test_what_needs_disarm(jogged, state):
    """A live change of mode or working point is refused, and so is all that came with it."""
    jogged.controller.state = state
    message = f"nothing was changed, the state is {state}: {MODE} needs disarm; {CENTRE} needs disarm"
    refused(jogged, CheckFailed, message, "set", changes={K: 0.5, MODE: "voltage", CENTRE: 65})
    assert jogged.value(K) == 0.6


LIMIT, REACTION = "axes.x.faults.following_error.limit_um", "axes.x.faults.strain.reaction"


@pytest.mark.parametrize("state", ["ARMING", "TRACKING", "HOLDING", "RAMPING"])
def test_protections_are_not_weakened_under_way(cell, state):
    """Tighter is taken at once; wider, or milder, only at rest, and by no way round: reload, candidate."""
    cell.controller.state = state
    cell("set", changes={LIMIT: 150, "signals.strain_x.max_age_us": 200, "faults.host.silent_ms": 500})
    weakens = "would weaken a protection and needs disarm"
    message = f"nothing was changed, the state is {state}: {REACTION} {weakens}; {LIMIT} {weakens}"
    refused(cell, CheckFailed, message, "set", changes={K: 0.5, LIMIT: 151, REACTION: "hold"})
    refused(cell, CheckFailed, ".*faults.host.silent_ms would weaken.*", "set", changes={"faults.host.silent_ms": 501})
    refused(cell, CheckFailed, f".*{re.escape(LIMIT)} {weakens}.*", "reload")
    assert cell.value(LIMIT) == 150
    if state == "TRACKING":
        refused(cell, CheckFailed, f".*{re.escape(LIMIT)} {weakens}", "candidate_set", changes={LIMIT: 151})
    cell.controller.state = "READY"
    cell("set", changes={LIMIT: None, REACTION: "warn"})
    assert (cell.value(LIMIT), cell.value(REACTION)) == (None, "warn")


@pytest.mark.parametrize("state", ["READY", "FAULT"])
def test_what_needs_disarm_at_rest(cell, state):
    cell.controller.state = state
    cell("set", changes={CENTRE: 65, "start.lift_s": 0.25})
    assert cell.controller.axes["centre_um"][0] == 65
    assert cell.controller.swaps[-1][0]["lift_cycles"] == 2500


def test_armed_at_the_last_moment(cell):
    """The state counts at the swap, not when the values were checked."""
    cell.controller.state = "READY"

    @contextlib.asynccontextmanager
    async def arm_before():
        cell.controller.state = "ARMING"
        yield

    cell.controller.commanding = arm_before
    refused(cell, CheckFailed, f".* the state is ARMING: {CENTRE} needs disarm", "set", changes={CENTRE: 65})


def test_advice_comes_with_the_swap_that_asks_for_it(tmp_path):
    """Once, though the file's line is gone with the swap."""
    cell = Cell(tmp_path, SIMULATED.read_text(), "READY")
    (warning,) = cell("set", changes={"signals.deviation_z.max_age_us": 50e3})["warnings"]
    assert warning.startswith("reference.horizon_ms: 20 ms are less than the 50 ms")
    assert cell("set", changes={"axes.y.authority_percent": 50})["warnings"] == []
    assert cell("set", changes={"signals.deviation_z.max_age_us": 3000})["warnings"] == []


def test_diff(cell):
    assert cell("diff")["differences"] == []
    cell("set", changes={K: 0.5})
    assert cell("diff") == {
        "file": str(cell.config),
        "changed_on_disk": False,
        "differences": [{"key": K, "file": 0.6, "running": 0.5, "change": "live"}],
    }
    cell.config.write_text(cell.config.read_text().replace("cpu: 1 ", "cpu: 0 "))
    found = cell("diff")
    assert found["changed_on_disk"] is True
    assert found["differences"][0] == {"key": "loop.cpu", "file": 0, "running": 1, "change": "needs restart"}
    cell.config.write_text("loop: [")
    with pytest.raises(ConfigError, match=r"cell.yaml:1: not YAML"):
        cell("diff")


def test_save(cell):
    before = cell.config.read_text()
    cell.config.chmod(0o640)
    cell("set", changes={K: 0.55})
    saved = cell("save")
    after = cell.config.read_text()
    assert saved["changed"] == [{"key": K, "old": 0.6, "new": 0.55}]
    assert after.count("#") == before.count("#")
    assert "K_V_per_um: 0.55" in after
    assert cell.config.stat().st_mode & 0o777 == 0o640
    assert prepare(cell.config).configuration == cell.controller.prepared.configuration
    assert cell.controller.prepared.source.hash == saved["sha256"] == prepare(cell.config).source.hash
    assert cell("diff")["differences"] == []
    assert [path.name for path in cell.config.parent.iterdir() if "part" in path.name] == []
    assert cell.entries[-1] == ("save", True, {K: (0.6, 0.55)}, None)


def test_save_over_an_edited_file(cell):
    """Refused, unless forced; then the editor's comments stay, but not the editor's values."""
    cell("set", changes={K: 0.55})
    edited = cell.config.read_text().replace("lift_s: 0.5", "lift_s: 0.7  # slower")
    cell.config.write_text(edited)
    refused(cell, CheckFailed, f"{cell.config} was changed on disk since it was loaded: .*", "save")
    assert cell.config.read_text() == edited
    changes = {change["key"]: (change["old"], change["new"]) for change in cell("save", force=True)["changed"]}
    assert changes == {"start.lift_s": (0.7, 0.5), K: (0.6, 0.55)}
    assert "lift_s: 0.5  # slower" in cell.config.read_text()
    assert prepare(cell.config).configuration == cell.controller.prepared.configuration


def test_save_where_it_cannot_be_written(cell, monkeypatch):
    cell("set", changes={K: 0.55})
    before = cell.config.read_text()

    def full(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("os.fsync", full)
    refused(cell, DeviceUnavailable, f"{cell.config} can't be written: No space left on device; .*", "save")
    assert cell.config.read_text() == before
    assert list(cell.config.parent.glob("*.part")) == []


def test_reload(cell):
    cell("set", changes={TI: 0.6})
    cell.config.write_text(cell.config.read_text().replace("K_V_per_um: 0.6", "K_V_per_um: 0.7  # anew"))
    swap = cell("reload")
    assert len(cell.controller.swaps) == 2
    assert (cell.value(K), cell.value(TI)) == (0.7, 0.571)
    assert {change["key"]: change["new"] for change in swap["changed"]}[TI] == 0.571
    assert cell.controller.prepared.source.text == cell.config.read_text()
    assert cell("diff") == {"file": str(cell.config), "changed_on_disk": False, "differences": []}
    cell("save")  # nothing was changed on disk since


RELOADS = {
    "not YAML": ("axes:\n", "axes: [\n", ConfigError, r".*cell.yaml:\d+: .*"),
    "wrong value": ("Ti_ms: 0.571", "Ti_ms: -1", ConfigError, r".*cell.yaml:\d+: axes.x.inner.Ti_ms: expected .*"),
    "needs disarm": ("lift_s: 0.5", "lift_s: 0.7", CheckFailed, "nothing was changed, .*: start.lift_s needs disarm"),
    "needs restart": ("seed: 1", "seed: 2", CheckFailed, "nothing was changed, .*: drivers.cell.seed needs restart"),
    "driver's option": ("seed: 1", "sed: 2", ConfigError, r".*cell.yaml:\d+: drivers.cell.sed: unknown key sed.*"),
}


@pytest.mark.parametrize(("old", "new", "error", "message"), RELOADS.values(), ids=RELOADS)
def test_reload_refused(cell, old, new, error, message):
    """The file as a whole, however many good changes there are beside the bad one."""
    cell.config.write_text(cell.config.read_text().replace("K_V_per_um: 0.6", "K_V_per_um: 0.7").replace(old, new))
    refused(cell, error, message, "reload")
    assert cell.value(K) == 0.6


def test_jog(jogged):
    assert jogged("jog", axis="x", by_um=5) == {"axis": "x", "target_um": 65}
    assert jogged("jog", axis="x", by_um=-2.5) == {"axis": "x", "target_um": 62.5}
    assert jogged("jog", axis="y", to_um=80) == {"axis": "y", "target_um": 80}
    assert list(jogged.controller.axes["reference"]["target_um"]) == [62.5, 80, 60]
    assert jogged.entries[1] == ("jog", True, {"reference.target_um.x": (65, 62.5)}, None)
    jogged("set", changes={K: 0.5})
    assert list(jogged.controller.axes["reference"]["target_um"]) == [62.5, 80, 60]


def test_where_a_jog_went_is_not_saved(jogged):
    """It would go there at the next arming, whoever arms it."""
    jogged("jog", axis="x", by_um=5)
    jogged("set", changes={K: 0.5})
    saved = jogged("save")
    assert [change["key"] for change in saved["changed"]] == [K]
    assert "target_um" not in jogged.config.read_text()
    jogged("set", changes={K: 0.4})
    assert list(jogged.controller.axes["reference"]["target_um"]) == [65, 60, 60]


def test_jog_refused(jogged):
    refused(jogged, ConfigError, ".*x 200 is outside range_um 20..110", "jog", axis="x", to_um=200)
    refused(jogged, UsageError, "there is no axis 'q'; there are x, y, z", "jog", axis="q", by_um=1)
    for state in ("READY", "ARMING", "HOLDING", "FAULT"):
        jogged.controller.state = state
        refused(jogged, CheckFailed, f"jog refused: the state is {state}; .*", "jog", axis="x", by_um=1)


def test_commands(cell):
    for verb, state in (("disarm", "RAMPING"), ("arm", "ARMING"), ("hold", "HOLDING")):
        before = cell.controller.state
        assert cell(verb) is None
        assert cell.entries[-1] == (verb, True, {"state": (before, state)}, None)
    assert cell.controller.commands == [states.DISARM, states.ARM, states.HOLD]
    assert cell.said == []
    refused(cell, CheckFailed, "reset refused: the state is HOLDING", "reset")
    assert cell.said == ["settled"]


FIELDS = {
    "arm with anything": ("arm", {"now": True}, "arm: now: unknown key now.*"),
    "status with anything": ("status", {"verbose": 1}, "status: verbose: unknown key verbose.*"),
    "set without": ("set", {}, "set: changes: missing, .*"),
    "set nothing": ("set", {"changes": {}}, "set: changes: expected a section, from 1 to 200 entries, .*"),
    "jog nowhere": ("jog", {"axis": "x"}, "jog: give either by_um or to_um"),
    "jog to infinity": ("jog", {"axis": "x", "to_um": 1e999}, "jog: to_um: .*"),
}


@pytest.mark.parametrize(("verb", "fields", "message"), FIELDS.values(), ids=FIELDS)
def test_fields_are_checked(cell, verb, fields, message):
    with pytest.raises(UsageError) as told:
        cell(verb, **fields)
    assert re.fullmatch(message, str(told.value), re.DOTALL)
    assert cell.controller.commands == cell.controller.swaps == []
    looked_only = verb in ("status", "get", "diff", "log")
    assert [entry[:2] for entry in cell.entries] == ([] if looked_only else [(verb, False)])
