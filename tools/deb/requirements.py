"""``requirements.py FOLDER``: copy all packages that the program and its gateway need into FOLDER, as they are here."""

import shutil
import sys
from importlib.metadata import distribution
from pathlib import Path

from packaging.requirements import Requirement

PROGRAM, EXTRAS = "micromanip", frozenset({"gateway"})


def needed() -> dict[str, frozenset[str]]:
    """Names of packages, each with its extras; the program itself is not in it."""
    found: dict[str, frozenset[str]] = {}
    todo = [(PROGRAM, EXTRAS)]
    while todo:
        name, extras = todo.pop()
        if name in found and extras <= found[name]:
            continue
        found[name] = extras | found.get(name, frozenset())
        for text in distribution(name).requires or []:
            requirement = Requirement(text)
            marker = requirement.marker
            if marker is None or any(marker.evaluate({"extra": extra}) for extra in found[name] | {""}):
                todo.append((requirement.name.lower().replace("_", "-"), frozenset(requirement.extras)))
    del found[PROGRAM]
    return found


def main() -> None:
    """Copy their files; programs and caches stay."""
    folder = Path(sys.argv[1])
    for name in needed():
        for file in distribution(name).files or []:
            if ".." in file.parts or "__pycache__" in file.parts:
                continue
            (folder / file).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy(file.locate(), folder / file)


if __name__ == "__main__":
    main()
