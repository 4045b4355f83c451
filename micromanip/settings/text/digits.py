"""How many digits of a number a configuration file keeps."""

from typing import Any


def rounded(value: Any) -> Any:
    """JSON data with as many digits of each number as are written, and no negative zero; it stays so when loaded."""
    if isinstance(value, dict):
        return {key: rounded(entry) for key, entry in value.items()}
    if isinstance(value, list):
        return [rounded(entry) for entry in value]
    return float(f"{value:.10g}") + 0.0 if isinstance(value, float) else value
