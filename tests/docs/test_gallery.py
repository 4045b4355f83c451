"""The gallery notebook runs as it is printed, and shows what its text says."""

from pathlib import Path

import jupytext
import pytest

ROOT = Path(__file__).resolve().parents[2]


@pytest.mark.compiled_only
@pytest.mark.long
def test_the_notebook_runs(monkeypatch, capsys):
    import matplotlib as mpl

    monkeypatch.chdir(ROOT)
    monkeypatch.setattr(mpl, "rcParams", mpl.rcParams.copy())
    mpl.use("Agg")
    notebook = jupytext.read(ROOT / "docs" / "gallery" / "runs.py")
    cells = [cell for cell in notebook.cells if cell.cell_type == "code"]
    assert len(cells) == 6
    names = {"__name__": "gallery"}
    for number, cell in enumerate(cells):
        exec(compile(cell.source, f"runs.py, cell {number}", "exec"), names)  # a notebook is run so
    verdicts = {each.axis: each.verdict for each in names["differences"] if each.quantity == "error rms"}
    assert verdicts == {"x": "higher", "y": "no difference shown", "z": "no difference shown"}
    assert names["step"].problem is None
    assert "x: 0." in capsys.readouterr().out
    figures = [names["plt"].figure(number) for number in names["plt"].get_fignums()]
    assert [len(figure.axes[0].lines) for figure in figures] == [2, 1, 1]
    names["plt"].close("all")
