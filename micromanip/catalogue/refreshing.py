"""``python -m micromanip.catalogue.refreshing CATALOGUE FOLDER...``: what is new there, read at low priority.

For those who serve meanwhile: reading a long recording takes a process of its own.
"""

from __future__ import annotations

import sys
from pathlib import Path

from micromanip.errors import MicromanipError

from .background import give_way
from .store import Catalogue


def main(arguments: list[str]) -> int:
    """Exit code; a line on stderr says what is wrong."""
    give_way()
    file, *folders = map(Path, arguments)
    try:
        with Catalogue(file) as catalogue:
            catalogue.refresh(folders)
    except MicromanipError as problem:
        sys.stderr.write(f"{problem}\n")
        return problem.exit_code
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
