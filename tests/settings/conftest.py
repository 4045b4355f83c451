"""A good configuration, and what is said of it once a line is changed."""

from pathlib import Path

import pytest

from micromanip.errors import ConfigError
from micromanip.rt.jit import Compiled
from micromanip.settings.load import load

GOOD = Path(__file__).with_name("cell.yaml")


class Cell:
    """A configuration file that a test may change; its relative name keeps the messages short."""

    good = GOOD
    text = GOOD.read_text()

    def with_change(self, old: str, new: str) -> str:
        assert self.text.count(old) == 1, f"{old!r} must single out one place in {GOOD.name}"
        return self.text.replace(old, new)

    def write(self, content: str | bytes) -> Path:
        file = Path("cell.yaml")
        file.write_bytes(content if isinstance(content, bytes) else content.encode())
        return file

    def message(self, content: str | bytes) -> str:
        with pytest.raises(ConfigError) as caught:
            load(self.write(content))
        return str(caught.value)


@pytest.fixture
def cell(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return Cell()


@pytest.fixture(scope="module")
def good_lines():
    return Cell.text.splitlines()


@pytest.fixture(autouse=True)
def _laws_as_in_the_host(monkeypatch):
    """A configuration is checked and compiled to gains without a compiler: the laws it calls are plain Python."""
    monkeypatch.setattr(Compiled, "laws_compiled", False)
