"""What the loop process is to do: the document that the host hands it with the memory (``orders.py``)."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from micromanip.settings.check import Prepared


def loop_orders(prepared: Prepared, places: Sequence[tuple[int, int]], socket_path: Path) -> dict[str, Any]:
    """Orders for the loop of `prepared`; `places`: where in its segment each driver's context begins, and its size."""
    configuration, wiring = prepared.configuration, prepared.wiring
    loop = configuration.loop
    drivers = [
        {
            "name": name,
            "driver": configuration.drivers[name].driver,
            "bus": name in wiring.buses,
            "options": wiring.options[name].model_dump_json(),
            "context": at,
            "context_bytes": size,
            "first_input": wiring.first_input[name],
            "first_output": wiring.first_output[name],
        }
        for name, (at, size) in zip(wiring.drivers, places, strict=True)
    ]
    return {
        "drivers": drivers,
        "period_ns": loop.period_ns,
        "cpu": loop.cpu,
        "priority": loop.priority,
        "spin_ns": round(loop.spin_us * 1e3),
        "refuse_without_rights": loop.limits == "hardware",
        "host": os.getpid(),
        "socket": str(socket_path),
    }
