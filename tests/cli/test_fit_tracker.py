"""`micromanip fit tracker`: from a recording to `reference.axes` of a configuration that then predicts better."""

import json
import re
from pathlib import Path

import pytest
from replay.recorded import recording

from micromanip.cli.fit_tracker import command
from micromanip.errors import CheckFailed, ConfigError, UsageError
from micromanip.settings.check import prepare
from micromanip.virtual.experiment import VirtualExperiment

from .test_analyse_error import CONFIG, CliRunner

pytestmark = [pytest.mark.compiled_only, pytest.mark.long]
SIMULATED = CONFIG / "simulated.yaml"


def asked(*arguments, of=command):
    result = CliRunner().invoke(of, [str(each) for each in arguments], catch_exceptions=False)
    return json.loads(result.stdout)


@pytest.fixture(scope="module")
def unfitted(tmp_path_factory):
    """The simulated cell, whose predictor knows what is said of all axes only."""
    text, sections = re.subn(r"\n  axes:\n(?:    .*\n)+", "\n", SIMULATED.read_text(encoding="utf-8"))
    assert sections == 1
    file = tmp_path_factory.mktemp("unfitted") / "simulated.yaml"
    file.write_text(text, encoding="utf-8")
    return file


@pytest.fixture(scope="module")
def recorded(unfitted, tmp_path_factory):
    """8 s of the simulated cell from arming on, as recorded."""
    prepared = prepare(unfitted)
    cell = VirtualExperiment(prepared, process=True).cell(prepared.configuration, prepared.samples)
    cell.arm()
    file = tmp_path_factory.mktemp("tracker") / "run.mcap"
    recording(file, prepared, cell.run(8.0))
    return file


@pytest.fixture(scope="module")
def fitted(recorded, unfitted, tmp_path_factory):
    """What was found of axis y, and the configuration that it was put into."""
    copied = tmp_path_factory.mktemp("into") / "cell.yaml"
    copied.write_bytes(unfitted.read_bytes())
    return asked(recorded, "--axis", "y", "--into", copied, "--json")["axes"]["y"], copied


def test_an_axis_is_found_and_put_into_a_configuration(fitted, unfitted):
    found, copied = fitted
    assert [each["frequency_Hz"] for each in found["oscillations"]] == pytest.approx([7.76], abs=0.01)
    assert found["noise_um"] == pytest.approx(0.5, rel=0.08)
    assert "# The simulated cell, tuned" in copied.read_text(), "comments stay"
    before, after = (prepare(file).configuration.reference for file in (unfitted, copied))
    assert after.of("y").noise_um == found["noise_um"]
    assert found["path_share_um"]["after_um"] < 0.92 * found["path_share_um"]["before_um"]
    assert after.of("x") == before.of("x")


def test_what_can_not_be_done_is_told_and_nothing_written(recorded, tmp_path):
    held = tmp_path / "held.yaml"
    text = (CONFIG / "factory.yaml").read_text()
    held.write_text(text)
    with pytest.raises(ConfigError, match=r"reference\.source must be signal"):
        asked(recorded, "--axis", "x", "--into", held, "--json")
    assert held.read_text() == text
    with pytest.raises(UsageError, match="there is no axis 'q'"):
        asked(recorded, "--axis", "q")
    with pytest.raises(CheckFailed, match="no recording of ours"):
        asked(Path(__file__))
