"""Packages of drivers, installed as pip would do it; a cell that was commissioned."""

import importlib
import sys
from types import SimpleNamespace

import pytest

from campaigns.report import CONFIG
from micromanip.cli.main import main

FACTORY = CONFIG / "factory.yaml"


@pytest.fixture(scope="session")
def commissioned(tmp_path_factory):
    """Axis y of the factory cell, commissioned once for all tests: its folder, and what was found."""
    from micromanip.design.commission import cell

    folder, found = tmp_path_factory.mktemp("commission"), []
    config = folder / "cell.yaml"
    config.write_bytes(FACTORY.read_bytes())
    with pytest.MonkeyPatch.context() as patch:
        commission_cell = cell.commission_cell
        patch.setattr(cell, "commission_cell", lambda *them: found.append(commission_cell(*them)) or found[0])
        main(["commission", str(config), "--axis", "y", "--out", str(folder / "out")])  # exits where it fails
    return SimpleNamespace(folder=folder, found=found[0])


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
