"""What the loop process is told when it starts: a JSON document on its standard input."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from micromanip.settings.check import Prepared


def loop_orders(
    prepared: Prepared, descriptors: Sequence[int], offsets: Sequence[int], socket_path: Path
) -> dict[str, Any]:
    """Orders for the loop of `prepared`; `offsets` (bytes) tell where each driver's context is in their segment."""
    configuration, wiring = prepared.configuration, prepared.wiring
    loop = configuration.loop
    drivers = [
        {
            "name": name,
            "driver": configuration.drivers[name].driver,
            "bus": name in wiring.buses,
            "options": wiring.options[name].model_dump_json(),
            "context": offset,
            "first_input": wiring.first_input[name],
            "first_output": wiring.first_output[name],
        }
        for name, offset in zip(wiring.drivers, offsets, strict=True)
    ]
    return {
        "descriptors": descriptors,
        "drivers": drivers,
        "period_ns": loop.period_ns,
        "cpu": loop.cpu,
        "priority": loop.priority,
        "spin_ns": round(loop.spin_us * 1e3),
        "refuse_without_rights": loop.limits == "hardware",
        "host": os.getpid(),
        "socket": str(socket_path),
    }
