"""The configuration that the gateway expects to run is the file's as it is now, not as it was at the start."""

import pytest

from micromanip.gateway import serving
from micromanip.settings.text.source import Source
from micromanip.settings.write import write_atomically

from .rings import status

TUNED, SAVED = "axes: {x: {centre_um: 66}}\n", "axes: {x: {centre_um: 67}}\n"


@pytest.fixture
def told(monkeypatch, tmp_path):
    """What the pages say of the configuration, as the controller runs with a text; of a gateway that was started."""
    file, found = tmp_path / "cell.yaml", {}
    file.write_text(TUNED)

    def begun(gateway, *_):
        found["cell"], found["differs"] = gateway._cell, gateway._differs

    monkeypatch.setattr(serving, "run", begun)
    options = serving.Options(file, tmp_path / "control.sock", "127.0.0.1:0", tmp_path / "tokens")
    serving.serve(options, lambda _: None)

    def running(text):
        found["cell"].status = status() | {"configuration_sha256": Source.parse(file, text).hash}
        return found["differs"]()

    return file, running


def test_what_was_saved_is_what_should_run(told):
    file, running = told
    assert running(TUNED) is None
    assert "is not what" in running(SAVED)
    write_atomically(file, SAVED)
    assert running(SAVED) is None
    assert "is not what" in running(TUNED)


def test_a_file_that_is_gone_or_spoilt_is_taken_as_it_was(told):
    file, running = told
    file.write_bytes(b"\xff\xfe")
    assert running(TUNED) is None
    file.unlink()
    assert running(TUNED) is None
    assert "is not what" in running(SAVED)
