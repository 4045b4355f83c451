"""Writing fitted models back into a configuration file, its comments and order kept.

A three-way merge of lines brings the program's changes into the text as somebody else wrote it (Khanna, Kunal and
Pierce, "A Formal Investigation of Diff3", FSTTCS 2007): what lies between lines that all three have is somebody's own
where the program changed nothing there, else the program's.
"""

from __future__ import annotations

import copy
import io
from collections.abc import Callable, Iterator, Mapping, Sequence
from difflib import SequenceMatcher
from pathlib import Path
from typing import Any

from pydantic import BaseModel
from ruamel.yaml import YAML
from ruamel.yaml.comments import CommentedMap, CommentedSeq
from ruamel.yaml.error import YAMLError

from micromanip.files import held, linked_file
from micromanip.settings.schema.axis import Axis, Outer, SetPoint
from micromanip.settings.schema.model import Configuration
from micromanip.settings.schema.reference import Jog, Tracker
from micromanip.settings.text.digits import rounded


def with_lines_kept(own: str, before: str, after: str) -> str:
    """`own` with what `after` has changed of `before`, which says the same as `own` in other lines."""
    texts = tuple(text.splitlines(keepends=True) for text in (own, before, after))
    result: list[str] = []
    ends = (0, 0, 0)
    for starts, count in _in_all(*texts):
        mine, old, new = (text[end:start] for text, end, start in zip(texts, ends, starts, strict=True))
        result += mine if new == old else new
        result += texts[0][starts[0] : starts[0] + count]
        ends = (starts[0] + count, starts[1] + count, starts[2] + count)
    return "".join(result)


def _in_all(
    own: Sequence[str], before: Sequence[str], after: Sequence[str]
) -> Iterator[tuple[tuple[int, int, int], int]]:
    """Where runs of lines that are in all three begin in each, and how long they are; an empty one at their ends."""
    to_own = _blocks(before, own)
    to_after = _blocks(before, after)
    i = k = 0
    while i < len(to_own) and k < len(to_after):
        (in_before, in_own, size), (there, in_after, there_size) = to_own[i], to_after[k]
        first, last = max(in_before, there), min(in_before + size, there + there_size)
        if first < last:
            yield (in_own + first - in_before, first, in_after + first - there), last - first
        if in_before + size < there + there_size:
            i += 1
        else:
            k += 1
    yield (len(own), len(before), len(after)), 0


def _blocks(a: Sequence[str], b: Sequence[str]) -> Sequence[tuple[int, int, int]]:
    return SequenceMatcher(None, a, b, autojunk=False).get_matching_blocks()


_WIDTH = 110


def node(value: Any, number: Callable[[float], float] = float) -> Any:
    """`value` as YAML shows it best: lists of plain values on one line; `number` says what is kept of one."""
    if isinstance(value, float):
        return number(value)
    if isinstance(value, dict):
        return CommentedMap((key, node(item, number)) for key, item in value.items())
    if isinstance(value, (list, tuple)):
        items = CommentedSeq(node(item, number) for item in value)
        if not any(isinstance(item, (CommentedMap, CommentedSeq)) for item in items):
            items.fa.set_flow_style()
        return items
    return value


def _plain(value: Any) -> Any:
    """The same with the digits that are written."""
    return node(value, rounded)


def edited(text: str, edit: Callable[[Any], None]) -> str:
    """YAML `text` after `edit` has changed its document in place; all lines that it did not change are kept."""
    yaml = YAML()
    yaml.width = _WIDTH
    yaml.indent(mapping=2, sequence=4, offset=2)
    document = yaml.load(text)
    before = _dumped(yaml, document)
    edit(document)
    after = _dumped(yaml, document)
    kept = with_lines_kept(text, before, after)
    try:
        means_the_same = yaml.load(kept) == yaml.load(after)
    except YAMLError:  # lines of both that do not go together
        means_the_same = False
    return kept if means_the_same else after


def _dumped(yaml: YAML, document: Any) -> str:
    stream = io.StringIO()
    yaml.dump(document, stream)
    return stream.getvalue()


def _own_section(axes: Any, axis: str) -> Any:
    """Section of `axis`; where it was written once and meant for several axes (*alias), this one gets its own."""
    if any(axes[other] is axes[axis] for other in axes if other != axis):
        axes[axis] = copy.deepcopy(axes[axis])
        axes[axis].yaml_set_anchor(None)
    return axes[axis]


def with_hysteresis(text: str, axis: str, model: BaseModel) -> str:
    """Configuration file `text` with another hysteresis model in one axis."""

    def edit(document: Any) -> None:
        section = _own_section(document["axes"], axis)
        section["hysteresis"] = _plain(model.model_dump(exclude_defaults=True))

    return edited(text, edit)


def with_outer(text: str, axis: str, outer: Outer) -> str:
    """Configuration file `text` with another outer loop in one axis."""

    def edit(document: Any) -> None:
        _own_section(document["axes"], axis)["outer"] = _plain(outer.model_dump(exclude_defaults=True))

    return edited(text, edit)


def with_tuning(text: str, axes: Mapping[str, Axis]) -> str:
    """Configuration file `text` with models, controllers and the note of their commissioning in each of `axes`."""

    def edit(document: Any) -> None:
        for name, axis in axes.items():
            section = _own_section(document["axes"], name)
            section["inner"] = _plain(axis.inner.model_dump())
            slew = axis.setpoint.slew_um_per_ms
            if section["setpoint"].get("slew_um_per_ms", SetPoint.model_fields["slew_um_per_ms"].default) != slew:
                section["setpoint"] = copy.deepcopy(section["setpoint"])  # several axes may share one
                section["setpoint"].yaml_set_anchor(None)
                section["setpoint"]["slew_um_per_ms"] = slew
            section["hysteresis"] = _plain(axis.hysteresis.model_dump(exclude_defaults=True))
            if axis.hysteresis_affine is not None:
                section["hysteresis_affine"] = _plain(axis.hysteresis_affine.model_dump(exclude_defaults=True))
            section.pop("outer", None)
            if axis.outer is not None:
                section["outer"] = _plain(axis.outer.model_dump())
            if axis.actuator is not None:
                section["actuator"] = _plain(axis.actuator.model_dump(exclude_none=True))
            section.pop("coupling", None)
            if axis.coupling is not None:
                section["coupling"] = _plain(axis.coupling.model_dump())
            if axis.commissioned is not None:
                section["commissioned"] = _plain(axis.commissioned.model_dump(exclude_defaults=True))

    return edited(text, edit)


def with_production(text: str, configuration: Configuration) -> str:
    """Configuration file `text` with the mode of every axis of `configuration`, following the tracker as it does.

    A tracker that the file describes itself stays as it is; a jog is written where it is another.
    """

    def edit(document: Any) -> None:
        for name, axis in configuration.axes.items():
            if document["axes"][name].get("mode", Axis.model_fields["mode"].default) != axis.mode:
                _own_section(document["axes"], name)["mode"] = axis.mode
        followed = document.get("reference", {}).get("source") == "signal"
        if isinstance(configuration.reference, Tracker) and not followed:
            document["reference"] = _plain(configuration.reference.model_dump(exclude_defaults=True))
        jogged, here = configuration.reference, document.get("reference", {})
        if isinstance(jogged, Jog) and list(here.get("range_um", jogged.range_um)) != list(jogged.range_um):
            document["reference"] = _plain(jogged.model_dump(exclude_defaults=True))

    return edited(text, edit)


def write_atomically(file: Path, text: str) -> None:
    """Replace `file` by `text`, whole or not at all; its permissions stay. Raises OSError.

    A link of root's or the caller's own is followed, anybody else's is replaced.
    """
    with held(linked_file(file)) as (folder, name):
        folder.write(name, text.encode())
