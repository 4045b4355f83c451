"""Kills one after the other: controllers that live and die on one socket and one device."""

import gc
import shutil
import sys
from pathlib import Path
from random import Random

from tools.running_controller import LOCKS_ELSEWHERE, QUICK, WAITING, Running, simulated

from .kills import LETHAL, Kill, Life
from .moments import WEIGHTS

VICTIMS = ("recorder", "host", "black box", "loop")
"""In turn; each second kill ends a controller, so that each of the others is killed in one that lives on."""
CHECKED = ("check_s: null", "check_s: 0.15")  # a stall of a busy machine must not outlast it
DEVICE = ("    driver: simulated\n", "    driver: simulated\n    device: bench\n")


def remains():
    """Shared memory: what is mapped or open in this process, and what has a name."""
    maps = [line.split(maxsplit=5)[-1] for line in Path("/proc/self/maps").read_text().splitlines()]
    links = [str(entry.readlink()) for entry in Path("/proc/self/fd").iterdir() if entry.is_symlink()]
    named = [entry.name for entry in Path("/dev/shm").iterdir() if "micromanip" in entry.name]
    return [text for text in (*maps, *links, *named) if "micromanip-" in text and "memfd" in text] + named


def campaign(count, seed, folder):
    """`count` kills; the same seed draws the same moments."""
    random = Random(seed)
    text = simulated(*QUICK, *WAITING, CHECKED, DEVICE)
    before = len(remains())
    life = None
    for k in range(count):
        victim = VICTIMS[k % len(VICTIMS)]
        moment = random.choices([*WEIGHTS], [*WEIGHTS.values()])[0]
        try:
            life = life or start(folder, text)
            kill = life.kill(victim, moment, random)
        except AssertionError as wrong:
            kill = Kill(victim, moment, violations=[f"the controller did not start: {wrong}"])
        if life is not None and (victim in LETHAL or kill.violations or k == count - 1):
            kill.left += life.close()
            shutil.rmtree(life.cell.folder)
            life = None
            gc.collect()
            kill.left += remains()[before:]
        yield kill


def start(folder, text):
    """A controller in READY, on the socket and the device of the one before."""
    cell = Running(
        folder,
        text,
        *("--socket", str(folder / "control.sock"), "--record", "run.h5", "--trips", "trips"),
        prefix=(sys.executable, "-c", LOCKS_ELSEWHERE, str(folder / "locks")),
    )
    cell.socket = folder / "control.sock"
    try:
        return Life(cell)
    except BaseException:
        cell.kill()
        cell.release()
        raise
