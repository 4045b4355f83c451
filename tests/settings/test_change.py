"""What a change of each key takes."""

import pytest

from campaigns.report import CONFIG
from micromanip.settings.change import changed, needs, said
from micromanip.settings.check import prepare, revise, validate
from micromanip.settings.load import load
from micromanip.settings.schema.key import DISARM, LIVE, RESTART
from micromanip.settings.schema.model import Configuration
from micromanip.settings.text.shape import Shape
from micromanip.settings.text.source import Source

SIMULATED = CONFIG / "paper.yaml"


def leaves(shape, path=()):
    """Every key of the models, ``<name>`` for a name of the user's choice; lists are one value."""
    if shape.variants:
        for variant in shape.variants:
            yield from leaves(variant, path)
    elif shape.fields:
        for key, field in shape.fields.items():
            yield from leaves(field, (*path, key))
    elif shape.type == "object":
        yield from leaves(shape.entry, (*path, "<name>"))
    else:
        yield path


ALL = sorted(set(leaves(Shape.of(Configuration))))


def test_of_every_key_it_is_said():
    assert len(ALL) > 80
    assert {said(path, "change") for path in ALL} == {LIVE, DISARM, RESTART}


@pytest.fixture(scope="module")
def running():
    return load(SIMULATED)


def revised(running, **sections):
    document = running.model_dump(mode="json")
    document.update({name: edit(document[name]) for name, edit in sections.items()})
    return validate(Source.of(document, SIMULATED))


def test_defaults_count_as_values(running):
    new = revised(running, loop=lambda loop: loop | {"priority": 79})
    assert changed(running, new) == {("loop", "priority"): (80, 79)}
    assert needs(running, new) == {("loop", "priority"): RESTART}


def test_another_set_of_axes_needs_a_restart(running):
    new = revised(running, axes=lambda axes: {name: axes[name] for name in "xy"}, signals=without_z, outputs=without_z)
    found = needs(running, new)
    assert {found[path] for path in found} == {RESTART}
    assert found["axes", "z", "inner", "K_V_per_um"] == RESTART


def without_z(section):
    return {name: value for name, value in section.items() if not name.endswith("_z")}


def test_another_order_of_axes_needs_a_restart(running):
    new = revised(running, axes=lambda axes: {name: axes[name] for name in "zyx"})
    assert needs(running, new) == {("axes",): RESTART}


def test_revise_keeps_the_drivers():
    prepared = prepare(SIMULATED)
    document = prepared.configuration.model_dump(mode="json")
    document["axes"]["x"]["inner"]["K_V_per_um"] = 0.5
    source = Source.of(document, SIMULATED)
    new = revise(prepared, validate(source), source)
    assert new.wiring is prepared.wiring
    assert new.source.hash != prepared.source.hash
    old_axes, new_axes = prepared.parameters[0]["axis"], new.parameters[0]["axis"]
    assert list(new_axes["pid"]["K_V_per_um"]) == [0.5, 0.6, 0.6]
    assert new_axes[1:].tobytes() == old_axes[1:].tobytes()
    restored = revise(new, prepared.configuration, prepared.source)
    assert restored.parameters.tobytes() == prepared.parameters.tobytes()
