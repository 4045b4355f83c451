"""Keys as they are typed, and what is said of wrong ones."""

import re

import pytest

from micromanip.errors import UsageError
from micromanip.settings.text.keys import assigned, key_path, selected, yaml_value

DOCUMENT = {
    "loop": {"rate_hz": 10000},
    "axes": {
        "x": {"inner": {"K_V_per_um": 0.6}, "outer": None, "weights": [0.1, 0.2]},
        "y": {"inner": {"K_V_per_um": 0.7}, "outer": None, "weights": [0.1, 0.2]},
    },
}
LEAVES = [
    ("loop", "rate_hz"),
    *((("axes", axis, *rest)) for axis in "xy" for rest in (("inner", "K_V_per_um"), ("outer",), ("weights",))),
]


@pytest.mark.parametrize("key", ["", ".", "axes..x", "axes.x[", "[1]", "a[-1]", "a[x]", "x" + "]" * 200])
def test_not_a_key(key):
    with pytest.raises(UsageError, match=r"is not a key; keys are written like axes\.x\.inner\.Ti_ms"):
        key_path(key)


def test_assigned_leaves_the_original_alone():
    new = assigned(DOCUMENT, DOCUMENT, {"axes.x.inner.K_V_per_um": 1, "axes.y.weights[1]": 2, "loop.cpu": None})
    assert new["axes"]["x"]["inner"] == {"K_V_per_um": 1}
    assert new["axes"]["y"]["weights"] == [0.1, 2]
    assert new["axes"]["x"]["weights"] == [0.1, 0.2]
    assert new["loop"] == {"rate_hz": 10000, "cpu": None}
    assert DOCUMENT["axes"]["y"]["weights"] == [0.1, 0.2]


@pytest.mark.parametrize(
    ("key", "message"),
    {
        "axs.x.inner.K_V_per_um": "unknown key axs.x.inner.K_V_per_um; did you mean axes.x.inner.K_V_per_um?",
        "axes.x.iner.K_V_per_um": "unknown key axes.x.iner.K_V_per_um; did you mean axes.x.inner.K_V_per_um?",
        "y.inner.K_V_per_um": "unknown key y.inner.K_V_per_um; did you mean axes.y.inner.K_V_per_um?",
        "inner.K_V_per_um": "unknown key inner.K_V_per_um; did you mean axes.x.inner.K_V_per_um?",
        "zzz.qqq": "unknown key zzz.qqq; `get` lists all keys",
        "axes.x.outer.model": "axes.x.outer.model: axes.x.outer is null; give the whole section, axes.x.outer={...}",
        "axes.x.weights[2]": "unknown key axes.x.weights[2]; did you mean axes.x.weights?",
    }.items(),
)
def test_no_such_section(key, message):
    with pytest.raises(UsageError, match=f"^{re.escape(message)}$"):
        assigned(DOCUMENT, DOCUMENT, {key: 1})


def test_every_wrong_key_is_told():
    with pytest.raises(UsageError) as told:
        assigned(DOCUMENT, DOCUMENT, {"axs.x.inner": 1, "axes.x.inner.K_V_per_um": 1, "zzz.qqq": 1})
    assert len(str(told.value).splitlines()) == 2
    with pytest.raises(UsageError) as told:
        assigned(DOCUMENT, DOCUMENT, {f"zzz{k}.qqq": 1 for k in range(200)})
    assert len(str(told.value).splitlines()) == 11
    assert str(told.value).endswith("\nand 190 more unknown keys")


def test_a_section_replaced_and_set_at_once():
    with pytest.raises(UsageError, match="another key of the same set replaces the section"):
        assigned(DOCUMENT, DOCUMENT, {"axes.x": 1, "axes.x.inner.K_V_per_um": 1})


def test_selected():
    assert selected(LEAVES, DOCUMENT, []) == LEAVES
    assert selected(LEAVES, DOCUMENT, ["axes.y"]) == LEAVES[4:]
    assert selected(LEAVES, DOCUMENT, ["axes.y.weights", "loop"]) == [LEAVES[0], LEAVES[6]]
    with pytest.raises(UsageError, match=r"unknown key axes.y.weihts; did you mean axes.y.weights\?"):
        selected(LEAVES, DOCUMENT, ["axes.y.weihts"])


@pytest.mark.parametrize("text", ["[1, 2", ".inf", "{a: 1, a: 2}", "!!python/object:os.system x"])
def test_not_yaml(text):
    with pytest.raises(UsageError, match=r"^axes.x.centre_um: "):
        yaml_value("axes.x.centre_um", text)
