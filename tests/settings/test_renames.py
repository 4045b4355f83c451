"""A file of an older layout: read as ever, one line says the new name, and what is written has it."""

from pathlib import Path

import pytest

from micromanip.errors import ConfigError
from micromanip.settings.change import needed
from micromanip.settings.commissioned import tuning_hash
from micromanip.settings.load import validate_document
from micromanip.settings.schema.key import LIVE
from micromanip.settings.schema.model import Configuration
from micromanip.settings.text import renames
from micromanip.settings.text.keys import key_path
from micromanip.settings.text.shape import Shape
from micromanip.settings.text.source import Source
from micromanip.settings.write import with_hysteresis
from micromanip.settings.write_values import with_values

FILE = Path(__file__).parents[2] / "config" / "paper.yaml"
NEW = FILE.read_text()
OLD = NEW.replace("schema_version: 2", "schema_version: 1").replace("control_weight:", "effort:  # of the LQR\n       ")
LINE = OLD.splitlines().index("      effort:  # of the LQR") + 1


def test_the_version_written_is_that_of_the_models():
    assert Shape.of(Configuration).fields["schema_version"].choices == [renames.VERSION]


def test_an_older_file_means_the_same():
    old, new = Source.parse(FILE, OLD), Source.read(FILE)
    assert old.data == new.data
    assert validate_document(old) == validate_document(new)
    assert old.notes == (
        f"{FILE}:{LINE}: axes.x.outer.effort: called control_weight since schema_version 2, and read as that, "
        "here and in 2 more places",
    )
    assert new.notes == ()
    assert old.hash != new.hash
    assert old.text.count("#") == OLD.count("#")


def test_aliases_and_quotes():
    axes = "axes:\n  x: &x {outer: &o {'effort': 3, model: 1}}\n  y: {<<: *x}\n  z: {outer: {<<: *o, effort : 4}}\n"
    source = Source.parse(FILE, f"schema_version:   1  # old\n{axes}")
    assert source.text.startswith("schema_version:   2  # old\n")
    weights = {name: axis["outer"]["control_weight"] for name, axis in source.data["axes"].items()}
    assert weights == {"x": 3, "y": 3, "z": 4}
    assert "effort" not in source.text


@pytest.mark.parametrize("version", ["true", "1.0", "0", "3", "[1]", "one", "null"])
def test_no_other_version_is_taken_for_an_old_one(version):
    text = OLD.replace("schema_version: 1", f"schema_version: {version}")
    source = Source.parse(FILE, text)
    assert (source.text, source.notes) == (text, ())
    with pytest.raises(ConfigError, match="schema_version: expected 2, not"):
        validate_document(source)


def test_both_names_are_one_too_many():
    text = OLD.replace("      effort:", "      control_weight: 3\n      effort:", 1)
    with pytest.raises(ConfigError, match="duplicate key, it is already on line"):
        Source.parse(FILE, text)


def test_what_is_written_has_the_new_name():
    source = Source.parse(FILE, OLD)
    assert with_values(source, source.data) == source.text
    for text in (source.text, with_hysteresis(source.text, "y", validate_document(source).axes["x"].hysteresis)):
        assert "schema_version: 2" in text
        assert (text.count("control_weight:"), text.count("effort:")) == (3, 0)


def test_the_old_name_in_a_file_of_today():
    text = NEW.replace("control_weight:", "effort:", 1)
    with pytest.raises(ConfigError) as told:
        validate_document(Source.parse(FILE, text))
    assert "axes.x.outer.effort: unknown key effort: it is called control_weight now" in str(told.value)


def test_set_takes_the_old_name():
    assert key_path("axes.x.outer.effort") == ("axes", "x", "outer", "control_weight")
    assert key_path("axes.x.inner.effort") == ("axes", "x", "inner", "effort")
    assert needed(key_path("axes.x.outer.effort")) == LIVE


def test_a_report_stays_that_of_its_axis():
    """The hash that `commission` wrote in the last version before the key was renamed."""
    axes = validate_document(Source.read(FILE)).axes
    assert tuning_hash(axes["x"]) == "646ed03c9e16fee4"
