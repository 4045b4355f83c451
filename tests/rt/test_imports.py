"""The real-time side knows numpy, numba and itself: whatever else it imported would be locked into memory with it."""

import ast
import sys
from pathlib import Path

import micromanip.rt

ALLOWED = {"numpy", "numba", "llvmlite", "micromanip.errors", "micromanip.files", *sys.stdlib_module_names}


def test_rt_imports_numpy_and_numba_only():
    found = {}
    for file in Path(micromanip.rt.__file__).parent.rglob("*.py"):
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Import):
                names = [name.name for name in node.names]
            elif isinstance(node, ast.ImportFrom) and not node.level:
                names = [node.module]
            else:
                continue
            found |= {name: file.name for name in names if not f"{name}.".startswith("micromanip.rt.")}
    assert "numba" in found
    assert {name: file for name, file in found.items() if not {name, name.split(".")[0]} & ALLOWED} == {}
