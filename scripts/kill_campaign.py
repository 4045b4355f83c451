"""``kill -9`` of host, loop, recorder and black box in turn, at random moments: `make soak-kill`.

Every cycle's outputs are watched from outside. After each kill: what is documented happened, nothing was left behind,
and the next controller, on the same socket and device, comes to READY and is not armed. Exit code 1 otherwise.
"""

from __future__ import annotations

import argparse
import gc
import json
import shutil
import sys
import tempfile
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from random import Random
from statistics import median

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "tests"))

from host.cell import LOCKS_ELSEWHERE, QUICK, WAITING, Running, simulated
from host.kills import LETHAL, Kill, Life
from host.moments import WEIGHTS

VICTIMS = ("recorder", "host", "black box", "loop")
"""In turn; each second kill ends a controller, so that each of the others is killed in one that lives on."""
CALMER = ("check_s: 0.05", "check_s: 0.15")  # a stall of a busy machine must not outlast it
DEVICE = ("    driver: simulated\n", "    driver: simulated\n    device: bench\n")


def remains() -> list[str]:
    """Shared memory: what is mapped or open in this process, and what has a name."""
    maps = [line.split(maxsplit=5)[-1] for line in Path("/proc/self/maps").read_text().splitlines()]
    links = [str(entry.readlink()) for entry in Path("/proc/self/fd").iterdir() if entry.is_symlink()]
    named = [entry.name for entry in Path("/dev/shm").iterdir() if "micromanip" in entry.name]
    return [text for text in (*maps, *links, *named) if "micromanip-" in text and "memfd" in text] + named


def campaign(count: int, seed: int, folder: Path) -> Iterator[Kill]:
    """`count` kills; the same seed draws the same moments."""
    random = Random(seed)
    text = simulated(*QUICK, *WAITING, CALMER, DEVICE)
    before = len(remains())
    life: Life | None = None
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


def start(folder: Path, text: str) -> Life:
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


def table(kills: list[Kill]) -> str:
    """A line a victim, then how often each moment was met."""
    lines = [f"{'killed':<10} {'times':>5}  {'largest step V':>14}  {'s until':>14}  {'left':>4}  outcome"]
    for victim in VICTIMS:
        met = [kill for kill in kills if kill.victim == victim]
        if not met:
            continue
        steps = max(kill.step_V for kill in met)
        seconds = [kill.seconds for kill in met if kill.seconds is not None]
        until = f"{median(seconds):.2f} to {max(seconds):.2f}" if seconds else "-"
        outcomes = ", ".join(f"{n}x {what}" for what, n in Counter(kill.outcome for kill in met).most_common())
        left = sum(len(kill.left) for kill in met)
        lines.append(f"{victim:<10} {len(met):>5}  {steps:>14.3f}  {until:>14}  {left:>4}  {outcomes}")
    frozen = [1e3 * kill.frozen_s for kill in kills if kill.frozen_s is not None]
    if frozen:
        lines.append(f"outputs of a dead loop stood still for {median(frozen):.0f} to {max(frozen):.0f} ms")
    states = Counter(kill.state + (f" ({kill.phase})" if kill.state == "ARMED" else "") for kill in kills)
    for title, counts in (("moment", Counter(kill.moment for kill in kills)), ("state at the kill", states)):
        lines.append(f"{title}: " + ", ".join(f"{n}x {name}" for name, n in counts.most_common()))
    return "\n".join(lines)


def main() -> int:
    """0 where everything was as documented."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--count", type=int, default=100, help="so many kills (100)")
    parser.add_argument("--seed", type=int, default=1, help="of the random moments (1)")
    parser.add_argument("--json", action="store_true", help="one document with every kill instead of the table")
    options = parser.parse_args()
    kills = []
    with tempfile.TemporaryDirectory(prefix="kill-") as folder:
        for kill in campaign(options.count, options.seed, Path(folder)):
            kills.append(kill)
            good = "ok" if not (kill.violations or kill.left) else f"WRONG: {kill.violations} left: {kill.left}"
            course = " -> ".join(kill.course)
            print(f"{len(kills):>4} {kill.victim}, {kill.moment}: {course}: {good}", file=sys.stderr, flush=True)
    wrong = sum(bool(kill.violations or kill.left) for kill in kills)
    if options.json:
        document = {"seed": options.seed, "wrong": wrong, "kills": [kill.document() for kill in kills]}
        print(json.dumps(document, indent=2))
    else:
        print(table(kills))
        print(f"{len(kills)} kills, seed {options.seed}: {wrong} not as documented")
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
