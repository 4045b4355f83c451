"""``micromanip get --watch``: values of the running loop as a live stream, a line a sample."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Any

import click

from micromanip.client import Client
from micromanip.errors import UsageError, nearest

from .options import emit_json_lines

if TYPE_CHECKING:
    from micromanip.gateway.fields import Field
    from micromanip.host.shared_memory import RingReader

_WIDTH = 14


def print_live_values(client: Client, names: Sequence[str], every_s: float, as_json: bool) -> None:
    """A line now and each `every_s`, with the newest cycle's values of `names`; ends where the controller goes away.

    A name is that of the scope, `x.strain_um`, or without the axis: then it stands for all axes. UsageError where there
    is no such value.
    """
    from micromanip.gateway.cell import mapped
    from micromanip.gateway.fields import fields
    from micromanip.host.shared_memory import RingReader

    about, descriptors = client.telemetry()
    _, ring, _ = mapped(about, descriptors)
    chosen = _chosen(fields(about["axes"]), names)
    samples = _samples(client, RingReader(ring), chosen, about["period_ns"], every_s)
    if as_json:
        emit_json_lines(samples)
        return
    widths = [max(_WIDTH, len(field.name)) for field in chosen]
    click.echo(
        "  ".join(f"{name:>{width}}" for name, width in zip(["t_s", *_names(chosen)], [10, *widths], strict=True))
    )
    for sample in samples:
        cells = [f"{sample['t_s']:10.4f}"]
        cells += [f"{_text(sample[field.name]):>{width}}" for field, width in zip(chosen, widths, strict=True)]
        click.echo("  ".join(cells))


def _chosen(fields: Sequence[Field], names: Sequence[str]) -> list[Field]:
    found: list[Field] = []
    for name in names:
        meant = [field for field in fields if name in (field.name, field.column)]
        if not meant:
            near = nearest(name, [field.name for field in fields])
            hint = f"did you mean {near}?" if near else f"they are {', '.join(_names(fields))}"
            raise UsageError(f"there is no value {name!r:.40} to watch; {hint}")
        found += [field for field in meant if field not in found]
    return found


def _names(fields: Sequence[Field]) -> list[str]:
    return [field.name for field in fields]


def _samples(
    client: Client, ring: RingReader, fields: Sequence[Field], period_ns: int, every_s: float
) -> Iterator[dict[str, Any]]:
    """The newest cycle each `every_s`; raises DeviceUnavailable where the controller is not there any more."""
    before, due_s = -1, time.monotonic()
    while True:
        row = ring.latest()
        if row is None or row["cycle"] == before:
            client.status()
        else:
            before = int(row["cycle"])
            rows = row.reshape(1)
            yield {"t_s": before * period_ns * 1e-9, **{field.name: field.of(rows)[0].item() for field in fields}}
        now_s = time.monotonic()
        due_s = max(due_s + every_s, now_s)
        time.sleep(due_s - now_s)


def _text(value: float) -> str:
    return f"{value:.4f}" if isinstance(value, float) else str(value)
