"""Pages that are walked: their commands are typed in order, and what is printed is what the page shows.

Numbers may differ by a twentieth (other processors round differently), measured times by anything. A line "..." stands
for any lines. What starts a controller, installs something or takes long is left out, and so is what needs its result.
"""

import itertools
import math
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from tests.further import further

ROOT = Path(__file__).resolve().parents[2]
BLOCK = re.compile(r"^```(?P<kind>\w*)\n(?P<text>.*?)^```$", re.DOTALL | re.MULTILINE)
SAVED = re.compile(r"[Ss]ave\s+(?:this|it)\s+as\s+`(?P<file>out/\w+\.py)`")
NOT_TYPED = re.compile(r"sudo |git clone|micromanip (run|status|arm)\b")
NUMBER = re.compile(r"[-+]?\d+(?:\.\d+)?(?:e[-+]?\d+)?")
MEASURED = "on this machine"


def blocks(page):
    """(kind, text, the text before it) of every block of a page, in order."""
    text, end = page.read_text(encoding="utf-8"), 0
    for match in BLOCK.finditer(text):
        yield match["kind"], match["text"], text[end : match.start()]
        end = match.end()


def same(shown, printed):
    """Whether two lines say the same."""
    if NUMBER.sub("#", shown).split() != NUMBER.sub("#", printed).split():
        return False
    pairs = zip(NUMBER.findall(shown), NUMBER.findall(printed), strict=True)
    return MEASURED in shown or all(math.isclose(float(a), float(b), rel_tol=0.05, abs_tol=1e-9) for a, b in pairs)


def difference(shown, printed):
    """The first line of the page that was not printed, with what came instead; None where there is none."""
    place, skipping = 0, False
    for line in shown:
        if line.strip() == "...":
            skipping = True
            continue
        while skipping and place < len(printed) and not same(line, printed[place]):
            place += 1
        if place == len(printed) or not same(line, printed[place]):
            return line, printed[place] if place < len(printed) else "(nothing more)"
        place, skipping = place + 1, False
    return None if skipping or place == len(printed) else ("(nothing more)", printed[place])


@pytest.mark.long
@pytest.mark.timeout(900)
@pytest.mark.parametrize(("page", "outputs"), [("quickstart.md", 3), *further(("record-and-replay.md", 1))])
def test_what_a_page_shows_is_printed(page, outputs, tmp_path):
    for name in ("config", "docs"):
        (tmp_path / name).symlink_to(ROOT / name)
    (tmp_path / "out").mkdir()
    path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    environment = os.environ | {"PATH": path, "COLUMNS": "120"}
    parts = [*blocks(ROOT / "docs" / page), ("", "", "")]
    compared = 0
    for (kind, text, before), (following, shown, _) in itertools.pairwise(parts):
        if kind == "python" and (file := SAVED.search(before[-400:])):
            (tmp_path / file["file"]).write_text(text, encoding="utf-8")
        answered = following == "" and bool(shown)
        if NOT_TYPED.search(text) or not (kind == "sh" or (kind == "python" and answered)):
            continue
        todo = ["bash", "-c", text] if kind == "sh" else ["python", "-c", text]
        typed = subprocess.run(todo, cwd=tmp_path, env=environment, capture_output=True, text=True, check=False)
        assert typed.returncode == 0, typed.stderr
        if answered:
            said = typed.stdout if "exit code" not in text else typed.stderr + typed.stdout
            wrong = difference(*([line for line in each.splitlines() if line.strip()] for each in (shown, said)))
            assert wrong is None, f"docs/{page} shows\n  {wrong[0]}\nand what is printed is\n  {wrong[1]}"
            compared += 1
    assert compared == outputs, "the page has its outputs where they are looked for"


def test_a_wrong_line_is_found():
    assert difference(["a 1.00", "...", "c"], ["a 1.02", "b", "b", "c"]) is None
    assert difference(["a 1.00", "c"], ["a 1.2", "c"]) == ("a 1.00", "a 1.2")
    assert difference(["a", "c"], ["a", "b", "c"]) == ("c", "b")
    assert difference(["a"], ["a", "b"]) == ("(nothing more)", "b")
