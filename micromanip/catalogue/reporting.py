"""``python -m micromanip.catalogue.reporting RECORDING``: its report on standard output, made at low priority.

For those who serve meanwhile.
"""

from __future__ import annotations

import sys
from pathlib import Path

from micromanip.design.recorded_run import RecordedRun
from micromanip.design.run_figures import run_figures
from micromanip.design.run_report import run_report
from micromanip.errors import MicromanipError, system_error
from micromanip.recordings import open_telemetry

from .background import give_way


def main(arguments: list[str]) -> int:
    """Exit code; a line on stderr says what is wrong."""
    give_way()
    file = Path(arguments[0])
    try:
        run = RecordedRun(open_telemetry(file))
        page = run_report(run, run_figures(run), {axis: run.axis[axis].steps.response() for axis in run.axes})
    except (MicromanipError, OSError) as problem:
        told = problem if isinstance(problem, MicromanipError) else system_error(problem, file)
        sys.stderr.write(f"{told}\n")
        return told.exit_code
    sys.stdout.write(page)
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
