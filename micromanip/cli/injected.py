"""The response of a running loop's plant, with a bar: for the commands that inject a multisine."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rich.console import Console
from rich.progress import Progress

from micromanip.design.running import plant_of

if TYPE_CHECKING:
    from micromanip.client import Client
    from micromanip.design.response import Measured
    from micromanip.replies import Injected


def inject(
    client: Client, axis: str, loop: str, amplitude_um: float, seed: int, draws: int
) -> tuple[Injected, Measured]:
    """What was injected last, and the plant's response to `draws` multisines with phases from `seed` on.

    Raises CheckFailed where the controller refuses it, or it was ended early.
    """
    responses = []
    with Progress(console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task(f"axis {axis}, {loop} loop", total=float(draws))
        for draw in range(draws):

            def tell(part: float, done: int = draw) -> None:
                bar.update(task, completed=done + part)

            begun, response = client.inject(axis, loop, amplitude_um, seed + draw, progress=tell)
            responses.append(response)
    return begun, plant_of(responses)
