"""How many digits of a number a configuration file keeps."""

WRITTEN_DIGITS = 10


def rounded(value: float) -> float:
    """`value` with as many digits as are written; what was written and loaded again stays as it is."""
    return float(f"{value:.{WRITTEN_DIGITS}g}")
