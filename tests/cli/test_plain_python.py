"""What needs compiled code says so in a sentence where there is none."""

from .command import code_of


def test_run_refuses_to_be_plain_python(monkeypatch, capsys, tmp_path):
    monkeypatch.setattr("micromanip.rt.jit.PLAIN", True)
    assert code_of("run", tmp_path / "cell.yaml") == 64
    assert "NUMBA_DISABLE_JIT is set" in capsys.readouterr().err
