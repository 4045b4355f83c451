"""Packages of drivers, installed as pip would do it."""

import importlib
import sys

import pytest


@pytest.fixture
def announce(tmp_path, monkeypatch):
    """Install a package `name` 1.5 with the driver `name`; its module is `text`, unless it is there already."""
    site = tmp_path / "site"
    made = []

    def install(name, value, text=None):
        info = site / f"{name}-1.5.dist-info"
        info.mkdir(parents=True)
        (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}-package\nVersion: 1.5\n")
        (info / "entry_points.txt").write_text(f"[micromanip.drivers]\n{name} = {value}\n")
        if text is not None:
            module = value.split(":")[0]
            (site / f"{module}.py").write_text(text)
            made.append(module)
        if str(site) not in sys.path:
            monkeypatch.syspath_prepend(str(site))
        importlib.invalidate_caches()

    yield install
    for module in made:
        sys.modules.pop(module, None)
