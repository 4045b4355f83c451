"""Writing values into a configuration file: only their keys change, comments and order stay.

A three-way merge of lines brings the program's changes into the text as somebody else wrote it (Khanna, Kunal and
Pierce, "A Formal Investigation of Diff3", FSTTCS 2007): what lies between lines that all three have is somebody's own
where the program changed nothing there, else the program's.
"""

from __future__ import annotations

import copy
import functools
import io
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from difflib import SequenceMatcher
from pathlib import Path
from typing import Any

from pydantic import BaseModel
from ruamel.yaml import YAML
from ruamel.yaml.comments import CommentedMap, CommentedSeq
from ruamel.yaml.error import YAMLError

from micromanip.errors import ConfigError, system_error
from micromanip.files import held, linked_file
from micromanip.settings.schema.axis import Axis, Outer, SetPoint
from micromanip.settings.schema.model import Configuration
from micromanip.settings.schema.reference import Jog, Tracker
from micromanip.settings.text.digits import rounded
from micromanip.settings.text.place import Path as KeyPath
from micromanip.settings.text.source import Source

from .change import ABSENT, differing, leaves

_WIDTH = 110
_PASSES = 5
"""A section that merged (``<<``) a changed one gets what it had back in the next pass, and one that is empty goes."""


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


def node(value: Any) -> Any:
    """`value` as YAML shows it best: lists of plain values on one line."""
    if isinstance(value, dict):
        return CommentedMap((key, node(item)) for key, item in value.items())
    if isinstance(value, (list, tuple)):
        items = CommentedSeq(map(node, value))
        if not any(isinstance(item, (CommentedMap, CommentedSeq)) for item in items):
            items.fa.set_flow_style()
        return items
    return value


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


def write_into(file: Source, document: Mapping[str, Any]) -> Source:
    """`file` after `document` was written into it; errors of `with_values`, or of the system where it can't be."""
    text = with_values(file, document)
    try:
        write_atomically(file.path, text)
    except OSError as problem:
        raise system_error(problem, f"{file.path} can't be written") from problem
    return Source.parse(file.path, text)


def with_values(source: Source, document: Mapping[str, Any]) -> str:
    """Text of the file `source` edited to hold `document`.

    Raises ConfigError where the file, as it is written, can't be edited to mean exactly that.
    """
    text, data = source.text, source.data
    for _ in range(_PASSES):
        if data == document:
            return text
        changes = differing(leaves(data), leaves(document))
        text = edited(text, functools.partial(_apply, changes))
        data = Source.parse(source.path, text).data
    if data == document:
        return text
    raise ConfigError(f"{source.path}: its anchors or merge keys can't be kept with these values; edit it by hand")


def _apply(changes: Mapping[KeyPath, tuple[Any, Any]], document: Any) -> None:
    for path, (_, new) in changes.items():
        if new is ABSENT:
            _remove(document, path)
    for path, (_, new) in changes.items():
        if new is not ABSENT:
            _put(document, path, new)


def _remove(document: Any, path: KeyPath) -> None:
    section = _descend(document, path[:-1], create=False)
    if section is not None:
        section.pop(path[-1], None)


def _put(document: Any, path: KeyPath, value: Any) -> None:
    section = _descend(document, path[:-1], create=True)
    if path[-1] not in section:
        section.fa.set_block_style()  # what grows has no room on one line
    section[path[-1]] = node(value)


def _descend(document: Any, path: KeyPath, *, create: bool) -> Any:
    """The section at `path`, one that no other place of the document shares; None where it is not there."""
    section = document
    for part in path:
        child = section.get(part)
        if not isinstance(child, CommentedMap):
            if not create:
                return None
            section[part] = CommentedMap()
        elif Counter(id(node) for node in _sections(document))[id(child)] > 1:  # an *alias
            section[part] = copy.deepcopy(child)
            section[part].yaml_set_anchor(None)
        section = section[part]
    return section


def _sections(node: Any) -> Iterable[Any]:
    if isinstance(node, CommentedMap):
        yield node
        for child in node.values():
            yield from _sections(child)
    elif isinstance(node, CommentedSeq):
        for child in node:
            yield from _sections(child)


def written(model: BaseModel, **how: Any) -> Any:
    """What a model says, with the digits that are written."""
    return rounded(model.model_dump(mode="json", **how))


def _with(text: str, change: Callable[[Any], None]) -> str:
    """Configuration file `text` after `change` has changed its plain data in place."""
    source = Source.parse(Path(), text)
    document = copy.deepcopy(source.data)
    change(document)
    return with_values(source, document)


def with_hysteresis(text: str, axis: str, model: BaseModel) -> str:
    """Configuration file `text` with another hysteresis model in one axis."""
    return _with(text, lambda data: data["axes"][axis].update(hysteresis=written(model, exclude_defaults=True)))


def with_outer(text: str, axis: str, outer: Outer) -> str:
    """Configuration file `text` with another outer loop in one axis."""
    return _with(text, lambda data: data["axes"][axis].update(outer=written(outer, exclude_defaults=True)))


def with_tuning(text: str, axes: Mapping[str, Axis]) -> str:
    """Configuration file `text` with models, controllers and the note of their commissioning in each of `axes`."""

    def tune(data: Any) -> None:
        for name, axis in axes.items():
            section, slew = data["axes"][name], axis.setpoint.slew_um_per_ms
            section["inner"] = written(axis.inner)
            if section["setpoint"].get("slew_um_per_ms", SetPoint.model_fields["slew_um_per_ms"].default) != slew:
                section["setpoint"]["slew_um_per_ms"] = slew
            section["hysteresis"] = written(axis.hysteresis, exclude_defaults=True)
            for key in ("outer", "coupling"):
                section.pop(key, None)
            for key, model, how in (
                ("hysteresis_affine", axis.hysteresis_affine, {"exclude_defaults": True}),
                ("outer", axis.outer, {}),
                ("actuator", axis.actuator, {"exclude_none": True}),
                ("coupling", axis.coupling, {}),
                ("commissioned", axis.commissioned, {"exclude_defaults": True}),
            ):
                if model is not None:
                    section[key] = written(model, **how)

    return _with(text, tune)


def with_production(text: str, configuration: Configuration) -> str:
    """Configuration file `text` with the mode of every axis of `configuration`, following the tracker as it does.

    A tracker that the file describes itself stays as it is; a jog is written where it is another.
    """

    def produce(data: Any) -> None:
        for name, axis in configuration.axes.items():
            if data["axes"][name].get("mode", Axis.model_fields["mode"].default) != axis.mode:
                data["axes"][name]["mode"] = axis.mode
        reference, here = configuration.reference, data.get("reference", {})
        follows = isinstance(reference, Tracker) and here.get("source") != "signal"
        jogs = isinstance(reference, Jog) and list(here.get("range_um", reference.range_um)) != list(reference.range_um)
        if follows or jogs:
            data["reference"] = written(reference, exclude_defaults=True)

    return _with(text, produce)


def write_atomically(file: Path, text: str) -> None:
    """Replace `file` by `text`, whole or not at all; its permissions stay. Raises OSError.

    A link of root's or the caller's own is followed, anybody else's is replaced.
    """
    with held(linked_file(file)) as (folder, name):
        folder.write(name, text.encode())
