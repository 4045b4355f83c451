"""The C twin of the cycle: compiled with the layout of this very version, called on numpy's own memory."""

from __future__ import annotations

import ctypes
import shutil
import subprocess
from pathlib import Path
from typing import Any

from micromanip.errors import CheckFailed
from micromanip.rt.laws import feedforward, hysteresis, reference
from micromanip.rt.states import STAGE

from .layout import write_header
from .runner import Skipped

_FLAGS = ("-std=gnu99", "-O3", "-march=native", "-Wall", "-Wextra", "-Werror", "-shared", "-fPIC")


def compile_c(source: str, folder: Path) -> ctypes.CDLL:
    """The library of a file beside this one, built in `folder`; raises Skipped where there is no gcc."""
    gcc = shutil.which("gcc")
    if gcc is None:
        raise Skipped("there is no gcc to compile the C twin; install the package gcc")
    library = folder / "twin.so"
    command = [gcc, *_FLAGS, f"-I{folder}", str(Path(__file__).parent / source), "-o", str(library), "-lm"]
    built = subprocess.run(command, capture_output=True, text=True, check=False)
    if built.returncode != 0:
        raise CheckFailed(f"gcc does not compile the C twin: {built.stderr.strip()}")
    return ctypes.CDLL(str(library))


def compile_twin(folder: Path) -> Any:
    """The function ``replay`` of ``twin.c``, built in `folder`; raises Skipped where there is no gcc."""
    write_header(folder)
    function = compile_c("twin.c", folder).replay
    function.argtypes = (
        [ctypes.c_void_p] * 6 + [ctypes.c_int64] * 2 + [ctypes.c_void_p, ctypes.c_int64, ctypes.c_void_p]
    )
    function.restype = None
    return function


def require_covered(parameters: Any) -> None:
    """Raise CheckFailed where `parameters` ask for a law that the twin does not have."""
    p = parameters[0]
    for i in range(p["axes"]):
        a = p["axis"][i]
        roles = ("stage", "deviation", "true_strain", "true_stage", "path_error", "uncompensated")
        if not (
            a["mode"] == STAGE
            and a["feedback"]
            and a["pid"]["notch_share"] == 0.0
            and a["awaited_cycles"] == 0.0
            and a["outer"]["tooth"] == 0
            and a["hysteresis"]["resonances"] == 0
            and a["hysteresis"]["lead"] == 0.0
            and a["hysteresis"]["creeps"] == 0
            and a["hysteresis"]["rate_cycles"] == 0.0
            and a["reference"]["kind"] == reference.SIGNAL
            and a["reference"]["steady"] == 0
            and not a["reference"]["detuning_high"].any()
            and a["decoupling"]["active"] == 0
            and a["hysteresis"]["kind"] == feedforward.PRANDTL_ISHLINSKII
            and a["hysteresis"]["shaping"]["kind"] == hysteresis.TANH
            and all(a[role] >= 0 for role in roles)
            and not any(p[line]["signal"] >= 0 for line in ("enable", "interlock", "retracted"))
            and not any(a[line]["signal"] >= 0 for line in ("amplifier_ok", "temperature_ok"))
            and not any(p[switch] >= 0 for switch in ("amplifier_enable", "feed_hold", "heartbeat"))
        ):
            raise CheckFailed(
                "the C twin covers only stage control after a tracker, with a tanh Prandtl-Ishlinskii model, and "
                "nothing else: no frequency that is followed, no second predictor, no digital inputs and outputs"
            )
