"""How many digits of a number a configuration file keeps."""

from typing import Any

WRITTEN_DIGITS = 10


def rounded(value: Any) -> Any:
    """JSON data with as many digits of each number as are written; what was loaded again stays as it is."""
    if isinstance(value, dict):
        return {key: rounded(entry) for key, entry in value.items()}
    if isinstance(value, list):
        return [rounded(entry) for entry in value]
    # + 0.0: there is no negative zero
    return float(f"{value:.{WRITTEN_DIGITS}g}") + 0.0 if isinstance(value, float) else value
