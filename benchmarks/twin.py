"""The C twin of the cycle, called on numpy's own memory.

It is compiled with ``records.h``, the controller's records and constants as C sees them, generated from the numpy
dtypes: a changed record can never be read with a stale layout. The C compiler asserts sizes and offsets once more.
"""

from __future__ import annotations

import ctypes
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from micromanip.errors import CheckFailed
from micromanip.rt import record, records, states, supervisor, telemetry
from micromanip.rt.laws import estimator, reference, sensor

from .recording import Outcome, Player, Recording
from .runner import Skipped

_FLAGS = ("-std=gnu99", "-O3", "-march=native", "-Wall", "-Wextra", "-Werror", "-shared", "-fPIC")
_C_TYPES = {"float64": "double", "int64": "int64_t", "int32": "int32_t"}
_ENUMERATIONS = (record, records, states, estimator)
_REASONS = ("MISSING", "GAUGE_LOST", "STAGE_LOST", "INNER_CALM", "FOUND")
_SINGLE = (
    (reference, ("MAX_MODES", "REFERENCE_STATES", "STOOD_STILL")),
    (sensor, ("BELIEVED",)),
    (supervisor, ("BEHIND", "MANY", "AT_ONCE", "REMEMBERED", *_REASONS)),
)
_WHOLE = (records.CELL_PARAMETERS, records.CELL_STATE, records.SIGNAL, telemetry.ROW)
"""Every other record is a part of one of these."""


def twin_player(folder: Path) -> Player:
    """Replay with the function ``replay`` of ``twin.c``, built in `folder`; raises Skipped where there is no gcc."""
    gcc = shutil.which("gcc")
    if gcc is None:
        raise Skipped("there is no gcc to compile the C twin; install the package gcc")
    (folder / "records.h").write_text(header(), encoding="utf-8")
    library = folder / "twin.so"
    command = [gcc, *_FLAGS, f"-I{folder}", str(Path(__file__).parent / "twin.c"), "-o", str(library), "-lm"]
    built = subprocess.run(command, capture_output=True, text=True, check=False)
    if built.returncode != 0:
        raise CheckFailed(f"gcc does not compile the C twin: {built.stderr.strip()}")
    function = ctypes.CDLL(str(library)).replay
    memory, count = ctypes.c_void_p, ctypes.c_int64
    function.argtypes = [memory] * 6 + [count, count, memory, count, memory]
    function.restype = None

    def play(recording: Recording, outcome: Outcome, repeats: int) -> None:
        inside = (recording.parameters, recording.state, outcome.state, recording.signals)
        places = [array.ctypes.data for array in (*inside, outcome.outputs, outcome.rows)]
        cycles, swept = len(recording.signals), recording.swept
        function(*places, cycles, repeats, swept.ctypes.data, len(swept), outcome.taken_ns.ctypes.data)

    return play


def header() -> str:
    """The text of ``records.h``."""
    lines = ["/* Generated from micromanip.rt by benchmarks/twin.py. */", "#ifndef RECORDS_H", "#define RECORDS_H"]
    lines += ["#include <stddef.h>", "#include <stdint.h>", ""]
    lines += [f"#define {name} {value}" for name, value in _constants().items()]
    names, known = _names(), set[str]()
    for dtype in _WHOLE:
        lines += _structures(dtype, names, known)
    return "\n".join([*lines, "", "#endif", ""])


def _constants() -> dict[str, float]:
    found = {
        name: value
        for module in _ENUMERATIONS
        for name, value in vars(module).items()
        if name.isupper() and isinstance(value, int)
    }
    return found | {name: getattr(module, name) for module, names in _SINGLE for name in names}


def _names() -> dict[np.dtype[Any], str]:
    """How the records are called where they stand: the constants of ``micromanip.rt``, in small letters."""
    modules = [module for name, module in sys.modules.items() if name.startswith("micromanip.rt.")]
    constants = [entry for module in modules for entry in vars(module).items()]
    return {value: name.lower() for name, value in constants if isinstance(value, np.dtype) and value.names}


def _structures(dtype: np.dtype[Any], names: dict[np.dtype[Any], str], known: set[str]) -> Iterator[str]:
    """A record behind those that are part of it, but for what is `known` by then."""
    if dtype.names is None or names[dtype] in known:
        return
    assert dtype.fields is not None
    name, places = names[dtype], {field: (dtype[field], dtype.fields[field][1]) for field in dtype.names}
    known.add(name)
    for element, _ in places.values():
        yield from _structures(element.base, names, known)
    yield from ("", f"struct {name} {{")
    for field, (element, _) in places.items():
        kind = _C_TYPES[element.base.name] if element.base.names is None else f"struct {names[element.base]}"
        yield f"    {kind} {field}{''.join(f'[{size}]' for size in element.shape)};"
    yield from ("};", f'_Static_assert(sizeof(struct {name}) == {dtype.itemsize}, "size of {name}");')
    for field, (_, offset) in places.items():
        yield f'_Static_assert(offsetof(struct {name}, {field}) == {offset}, "place of {name}.{field}");'
