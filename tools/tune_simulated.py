"""Commission config/factory.yaml and put what was found into config/simulated.yaml: `make tune`.

Both describe the same cell: simulated.yaml has what is written by hand beside it, limits, soft start and the reference.
"""

import datetime
import re
import sys
from importlib.metadata import version
from pathlib import Path

from micromanip.design.commission.cell import commission_cell
from micromanip.design.commission.knobs import Knobs
from micromanip.settings.check import prepare
from micromanip.settings.commissioned import tuning_hash
from micromanip.settings.schema.axis import Commissioned
from micromanip.settings.write import with_tuning, write_atomically
from micromanip.virtual.experiment import VirtualExperiment

CONFIG = Path(__file__).resolve().parent.parent / "config"
TOOTH_HZ, SEED = 200.0, 1
HEADER = """\
# The simulated cell, tuned: three axes hold the spindle on its path while the robot deviates and the
# tool cuts. Physical units, named by the keys; every key is explained in docs/configuration.md.
# The tuning of the axes (inner, hysteresis, hysteresis_affine, outer, actuator) is what `make tune` made of
# config/factory.yaml: `micromanip commission`, all axes, tooth frequency {tooth:g} Hz, seed {seed}, version {version},
# {date}. It passes `micromanip analyse`. The rest is written by hand.
"""


def _say(what: str) -> None:
    sys.stderr.write(f"{what}\n")


def main() -> int:
    """Commission all axes in virtual time; exit code 1 where a criterion is missed, and nothing is written."""
    factory = prepare(CONFIG / "factory.yaml")
    found = commission_cell(
        factory.configuration,
        VirtualExperiment(factory),
        list(factory.configuration.axes),
        _say,
        Knobs(tooth_Hz=TOOTH_HZ),
        SEED,
    )
    if not found.passed:
        missed = [f"{c.axis}: {c.name}: {c.value}" for story in found.evidence for c in story.criteria if not c.passed]
        sys.stderr.write("\n".join([*missed, "nothing was written\n"]))
        return 1
    today, target = datetime.datetime.now(datetime.UTC).date().isoformat(), CONFIG / "simulated.yaml"
    axes = {}
    for name, axis in found.configuration.axes.items():
        running = axis.model_copy(update={"mode": "stage"})
        note = Commissioned(hash=tuning_hash(running), report="report.html", date=today)
        axes[name] = running.model_copy(update={"commissioned": note})
    text = with_tuning(target.read_text(encoding="utf-8"), axes)
    header = HEADER.format(tooth=TOOTH_HZ, seed=SEED, version=version("micromanip"), date=today)
    write_atomically(target, re.sub(r"\A(#.*\n)*", lambda _: header, text))
    return 0


if __name__ == "__main__":
    sys.exit(main())
