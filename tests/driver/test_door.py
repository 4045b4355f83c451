"""The door for drivers: whole, light, the only one that drivers and pages use."""

import ast
import functools
import re
import subprocess
import sys
from pathlib import Path

import pytest

import micromanip.driver

ROOT = Path(__file__).resolve().parents[2]
IMPORT = re.compile(r"^\s*(?:from|import) (micromanip(?:\.\w+)*)", re.MULTILINE)


@functools.cache
def loaded(module):
    """What importing `module` imports in a new process."""
    code = f"import sys, {module}; print(*sys.modules)"
    return subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True).stdout.split()


def test_every_name_is_there():
    imports = (
        node
        for node in ast.walk(ast.parse(Path(micromanip.driver.__file__).read_text(encoding="utf-8")))
        if isinstance(node, ast.ImportFrom) and node.module.startswith("micromanip.")
    )
    for name in (alias.name for node in imports for alias in node.names):
        assert getattr(micromanip.driver, name) is not None, name
        assert (
            name in micromanip.driver.__doc__
            or name.endswith("Error")
            or (issubclass(getattr(micromanip.driver, name), micromanip.driver.BusError))
        ), f"{name} is not in the table"
    with pytest.raises(AttributeError, match="has no Nonsense"):
        _ = micromanip.driver.Nonsense


@pytest.mark.parametrize("unwanted", ["numba", "pytest", "micromanip.settings.check"])
@pytest.mark.parametrize("module", ["micromanip.driver", "micromanip_drivers.canbus.driver"])
def test_a_bus_driver_loads_neither_compiler_nor_suite(module, unwanted):
    assert module in loaded(module)
    assert unwanted not in loaded(module)


def test_pages_and_examples_come_in_by_the_door():
    files = [*(ROOT / "docs" / "examples").rglob("*.py"), ROOT / "docs" / "write-a-driver.md"]
    imported = {name for file in files for name in IMPORT.findall(file.read_text(encoding="utf-8"))}
    assert imported
    assert {name for name in imported if not name.startswith("micromanip.driver")} == set()
