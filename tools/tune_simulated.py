"""Fit the models in config/simulated.yaml anew, from the simulation's own noisy recordings: `make tune`."""

import sys
from pathlib import Path

from micromanip.design.tuning import tune
from micromanip.settings.check import prepare
from micromanip.settings.write import with_models, write_atomically
from micromanip.virtual.experiment import VirtualExperiment

CONFIG = Path(__file__).resolve().parent.parent / "config"


def main() -> None:
    """Start from the untuned cell of the same drivers, write the tuned one."""
    factory = prepare(CONFIG / "factory.yaml")
    tuned = tune(factory.configuration, VirtualExperiment(factory), lambda line: sys.stderr.write(f"{line}\n"))
    target = CONFIG / "simulated.yaml"
    write_atomically(target, with_models(target.read_text(encoding="utf-8"), tuned))


if __name__ == "__main__":
    main()
