"""How large the rooms are, beside their budgets: ``python -m tools.lines``, the end of `make lint`.

Lines of Python and JavaScript without the blank ones, third-party files aside. Ends with 1 where a room has outgrown
its ceiling, which is lowered as the room shrinks and never raised.
"""

import re
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
ROOMS = {  # the first that fits a file has it: pattern of paths, budget, ceiling
    "rt": (r"micromanip/rt/", 5400, 6481),
    "bus, driver": (r"micromanip/(bus|driver)/", 3000, 3822),
    "settings, control": (r"micromanip/(settings|control)/", 5000, 5718),
    "host": (r"micromanip/host/", 7500, 7648),
    "design, virtual, replay": (r"micromanip/(design|virtual|replay)/", 13500, 14130),
    "recordings": (r"micromanip/recordings/", 1900, 2351),
    "gateway": (r"micromanip/gateway/", 4200, 4219),
    "cli": (r"micromanip/cli/", 4300, 4850),
    "drivers and their devices": (r"drivers/|micromanip/emulation/\w+/", 15500, 16348),
    "emulation, testbus, conformance": (r"micromanip/(emulation|testbus|conformance)/", 3200, 3212),
    "campaigns, benchmarks, tools": (r"(campaigns|benchmarks|tools)/", 4200, 4672),
    "tests": (r"tests/", 40000, 41619),
    "the rest": (r"", 2000, 1857),
}
WORDS, DECISIONS = (45000, 43700), (30, 29)
"""Of the manual, without the decisions; how many decisions."""


def main() -> int:
    """Print the table."""
    listed = subprocess.run(["git", "ls-files"], cwd=ROOT, capture_output=True, text=True, check=True).stdout
    files = [ROOT / name for name in listed.splitlines() if (ROOT / name).is_file()]
    found = dict.fromkeys(ROOMS, 0)
    for file in files:
        name = file.relative_to(ROOT).as_posix()
        if file.suffix in (".py", ".js") and "third_party" not in name:
            room = next(room for room, (pattern, *_) in ROOMS.items() if re.match(pattern, name))
            found[room] += sum(bool(line.strip()) for line in file.read_text(encoding="utf-8").splitlines())
    pages = [file for file in files if re.fullmatch(r"README\.md|docs/.*\.md", file.relative_to(ROOT).as_posix())]
    decisions = [page for page in pages if page.parent.name == "decisions"]
    manual = [page for page in pages if page.parent.name not in ("decisions", "reports")]
    words = sum(len(page.read_text(encoding="utf-8").split()) for page in manual)
    rows = [(room, lines, *ROOMS[room][1:]) for room, lines in found.items()]
    rows += [("words of the manual", words, *WORDS), ("decisions", len(decisions), *DECISIONS)]
    print(f"{'room':33}{'lines':>8}{'budget':>8}{'ceiling':>9}")
    for name, size, budget, ceiling in rows:
        print(f"{name:33}{size:8}{budget:8}{ceiling:9}{'  OUTGROWN' * (size > ceiling)}")
    print(f"{'all lines':33}{sum(found.values()):8}")
    return int(any(size > ceiling for _, size, _, ceiling in rows))


if __name__ == "__main__":
    sys.exit(main())
