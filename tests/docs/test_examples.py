"""The drivers of docs/write-a-driver.md: installed, run in virtual time, found from their pages."""

import re
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

import numpy as np
import pytest

from micromanip.bus.registry import driver_class, findings
from micromanip.driver.testing import call_context, virtual_cell
from micromanip.errors import ConfigError
from micromanip.settings.check import prepare, validate
from micromanip.settings.text.source import Source
from micromanip.settings.wiring.single_driver import driver_to_probe

ROOT = Path(__file__).resolve().parents[2]
EXAMPLES = ROOT / "docs" / "examples"
SHOWN = [
    file
    for file in sorted(EXAMPLES.rglob("*"))
    if file.suffix in {".py", ".c", ".toml", ".yaml"} and file.name != "__init__.py" and "build" not in file.parts
]


@pytest.fixture
def installed(tmp_path, monkeypatch):
    """Install an example as pip would: its folder importable, its entry points known."""

    def install(name):
        project = tomllib.loads((EXAMPLES / name / "pyproject.toml").read_text(encoding="utf-8"))["project"]
        info = tmp_path / "site" / f"{name}-{project['version']}.dist-info"
        info.mkdir(parents=True)
        (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: {project['version']}\n")
        lines = [f"[{group}]" for group in project["entry-points"]]
        lines += [f"{k} = {v}" for group in project["entry-points"].values() for k, v in group.items()]
        (info / "entry_points.txt").write_text("\n".join(lines))
        monkeypatch.syspath_prepend(str(info.parent))
        monkeypatch.syspath_prepend(str(EXAMPLES / name))
        return EXAMPLES / name / "cell.yaml"

    yield install
    for name in [name for name in sys.modules if name.split(".")[0] in {"lag_stage", "c_card"}]:
        del sys.modules[name]


def test_numba_example_moves_as_its_page_says(installed):
    cell = virtual_cell(installed("lag_stage"))
    rows = np.concatenate([cell.arm(), cell.run(0.2)])
    axis = rows["axis"][:, 0]

    expected, position = np.empty(len(rows)), 0.0
    share = -np.expm1(-0.1 / 0.5)
    for k in range(len(rows)):
        position += share * (0.9 * (axis["voltage_V"][k - 2] if k > 1 else 0.0) - position)
        expected[k] = position
    assert rows["cycle"][0] == 1
    np.testing.assert_allclose(axis["strain_um"][1:], expected[1:], atol=1e-9)
    assert axis["strain_um"][-1] == pytest.approx(55.0, abs=1e-3), "the PID brings the gauge to the step's height"


def test_c_example_plays_a_sine(installed, tmp_path, monkeypatch):
    gcc = shutil.which("gcc")
    if gcc is None:
        pytest.skip("there is no gcc to compile card.c")
    (tmp_path / "out").mkdir()
    monkeypatch.chdir(tmp_path)
    source = EXAMPLES / "c_card" / "card.c"
    command = [gcc, "-std=c99", "-O2", "-Wall", "-Wextra", "-Werror", "-shared", "-fPIC"]
    subprocess.run([*command, "-o", "out/libcard.so", str(source)], check=True)

    config = installed("c_card")
    cell = virtual_cell(config)
    cell.arm()
    axis = cell.run(0.1)["axis"][:, 0]
    np.testing.assert_allclose(axis["strain_um"][2:], 0.9 * axis["voltage_V"][:-2], atol=1e-12)
    assert axis["voltage_V"].min() == pytest.approx(40.0, abs=0.01)
    assert axis["voltage_V"].max() == pytest.approx(80.0, abs=0.01)

    driver = prepare(config).wiring.drivers["card"]
    context = driver.context()
    functions = driver.functions()
    record = context.view([("um_per_V", "f8"), ("output_V", "f8"), ("is_open", "i8")])[0]
    assert call_context(functions.open, context.ctypes.data) == 0
    assert record["is_open"] == 1
    record["output_V"] = 80.0
    assert call_context(functions.safe, context.ctypes.data) == 0
    assert record["output_V"] == 0.0
    assert call_context(functions.close, context.ctypes.data) == 0
    assert record["is_open"] == 0


def test_c_example_says_what_to_do_without_its_library(installed, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(ConfigError, match=r"cell\.yaml:4: drivers\.card\.library: .*compile it first"):
        prepare(installed("c_card"))


def test_examples_are_found_by_their_entry_points(installed):
    installed("lag_stage")
    assert driver_class("lag_stage").simulated
    with pytest.raises(ConfigError, match="did you mean lag_stage"):
        driver_class("lag_stages")


def test_bus_example_is_found_and_built_from_its_configuration(installed):
    config = installed("udp_stage")
    assert not findings(driver_class("udp_stage"))
    assert set(validate(Source.read(config)).axes) == {"x", "y"}
    assert driver_to_probe(config, "stage").device == "udp 127.0.0.1:5005"


@pytest.mark.parametrize("file", SHOWN, ids=lambda file: str(file.relative_to(EXAMPLES)))
def test_page_shows_or_links_each_file(file):
    page = (ROOT / "docs" / "write-a-driver.md").read_text(encoding="utf-8")
    linked = f"]({file.relative_to(ROOT / 'docs')})" in page
    assert linked or file.read_text(encoding="utf-8") in page, f"the page must link or show {file.relative_to(ROOT)}"


def test_virtual_cell_of_the_page_prints_what_it_says(installed, monkeypatch, capsys):
    page = (ROOT / "docs" / "write-a-driver.md").read_text(encoding="utf-8")
    program, printed = re.search(r"```python\n([^`]*virtual_cell[^`]*)```\n\nIt prints ([\d.]+\d):", page).groups()
    installed("lag_stage")
    monkeypatch.chdir(ROOT)
    exec(program, {})
    assert float(capsys.readouterr().out) == pytest.approx(float(printed), abs=1e-9)
