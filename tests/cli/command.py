"""A command line, typed in this process."""

from micromanip.cli.main import main


def code_of(*arguments):
    """Its exit code."""
    try:
        main(list(map(str, arguments)))
    except SystemExit as ended:
        return ended.code
    return 0
