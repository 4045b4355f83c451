"""The configuration reference in Markdown, generated from the models.

``make docs`` writes ``docs/configuration.md`` from it; a test compares the two.
"""

from __future__ import annotations

import json
import re
import sys
from collections import Counter
from collections.abc import Container, Iterator, Mapping, Sequence

from micromanip.settings.schema.faults import REACTIONS
from micromanip.settings.schema.key import NEITHER
from micromanip.settings.schema.model import Configuration
from micromanip.settings.text.shape import Shape

_INTRODUCTION = """\
# Configuration reference

Generated from `micromanip/settings/schema/` by `make docs`; edit the descriptions there.

The file is YAML 1.2: `1e-3` is a number; `on`, `yes` and `no` are text, the truth values are `true` and `false`. The
unit of a value stands in its key: `Ti_ms` is in milliseconds. An unknown or repeated key is an error. `null` means
"none" or "no limit", where the type allows it; infinity and NaN are refused. Anchors and merge keys (`&tuned`,
`<<: *tuned`) save repetition between axes.

`<name>` stands for a name of your choice, `[i]` for an entry of a list. Each key stands with its default; a key without
one is required. A key whose value is a section with defaults only has no row.

The words in brackets are the range and what a change takes while the controller runs ([Tune](tune.md)). *live*: the
change is applied at a cycle boundary. *disarm*: the outputs must be at rest. *restart*: a new start is needed. A value
that protects less than the present one needs disarm, too: "weaker if larger" says which one it is.
"""
_HEADER = "| Key | Meaning |\n|---|---|\n"
_OBVIOUS = ("a number", "a whole number", "true or false", "text", "a section")
"""Types that the default or the meaning shows."""
_UNSAID = re.compile(r"(each )*-1000000000000\.\.1000000000000(, )?|(each )?at least 1 (character|entry)")
"""Limits that a reader takes for granted: finite, and not empty."""
_OFTEN = 3
"""Sections that have a key alike, from which it is described once."""


def render() -> str:
    """The whole reference."""
    shape = Shape.of(Configuration)
    return page(_INTRODUCTION, [("## The whole file", shape, ()), *sections(shape)])


Section = tuple[str, Shape | str, Container[str]]
"""Heading with its sentence; keys, or a sentence in their place; keys that have no row."""


def page(introduction: str, parts: Sequence[Section]) -> str:
    """A page of sections, of which the keys that many have alike stand once, in a table at the beginning."""
    tables = [_rows(shape, known) for _, shape, known in parts if isinstance(shape, Shape)]
    counted = Counter((key, row) for rows in tables for key, row in rows.items())
    shared: dict[str, str] = {}
    for (key, row), times in counted.most_common():
        if times >= _OFTEN:
            shared.setdefault(key, row)
    common = ["## Keys of several sections\n\n" + _HEADER + "".join(shared[key] for key in sorted(shared))] * bool(
        shared
    )
    return "\n".join([introduction, *common, *(_section(*part, shared) for part in parts)])


def sections(shape: Shape, within: str = "", written: dict[tuple[str, ...], str] | None = None) -> Iterator[Section]:
    """The sections of all keys of a model, nested ones too.

    `within` is the path of the model. `written` has the sections of the page so far, which are not repeated.
    """
    written = {} if written is None else written
    for key, field in shape.fields.items():
        yield from _nested(f"{within}{key}", field, written, told=_has_row(field))


def _nested(path: str, shape: Shape, written: dict[tuple[str, ...], str], *, told: bool = False) -> Iterator[Section]:
    """The sections at a path, each variant of a union, and all that are nested in them.

    `told` says that a row above has the description.
    """
    if key := shape.discriminator:
        for variant in shape.variants:
            yield from _nested(f"{path} with {key}: {variant.fields[key].words()}", variant, written)
    elif shape.fields:
        level = "###" if "." in path.replace(".<name>", "") else "##"
        kind = (shape.title, *shape.fields)
        if earlier := written.get(kind):
            yield f"{level} `{path}`", f"As `{earlier}`.", ()
            return
        written[kind] = path
        bare, _, choice = path.partition(" with ")
        prose = "" if told else f"\n\n{_prose(shape.description)}"
        yield f"{level} `{path}`{prose}", shape, (choice.split(":")[0],)
        for key, field in shape.fields.items():
            yield from _nested(f"{bare}.{key}", field, written, told=_has_row(field))
    elif shape.entry:
        yield from _nested(path + ("[i]" if shape.type == "array" else ".<name>"), shape.entry, written)


def _section(heading: str, shape: Shape | str, known: Container[str], shared: Mapping[str, str]) -> str:
    if isinstance(shape, str):
        return f"{heading}\n\n{shape}\n"
    rows = _rows(shape, known)
    own = "".join(row for key, row in rows.items() if shared.get(key) != row)
    also = ", ".join(f"`{key}`" for key, row in rows.items() if shared.get(key) == row)
    joint = _joint(shape, known)
    parts = [
        heading,
        f"Change: {joint}." if joint else "",
        (_HEADER + own).rstrip() if own else "",
        f"{'Also' if own else 'Keys:'} {also}." if also else "",
    ]
    return "\n\n".join(filter(None, parts)) + "\n"


def _fields(shape: Shape, known: Container[str]) -> dict[str, Shape]:
    return {key: field for key, field in shape.fields.items() if _has_row(field) and key not in known}


def _joint(shape: Shape, known: Container[str]) -> str:
    """What a change of each key takes, if it is the same for all."""
    fields = _fields(shape, known)
    changes = {_change(field) for field in fields.values()}
    return changes.pop() if len(changes) == 1 and len(fields) > 1 else ""


def _rows(shape: Shape, known: Container[str]) -> dict[str, str]:
    """The rows of a section by key."""
    joint = _joint(shape, known)
    return {
        key: _row(key, field, joint, required=key in shape.required) for key, field in _fields(shape, known).items()
    }


def _has_row(field: Shape) -> bool:
    """A section follows under its own heading; its row would say nothing more, unless it can be null or is a choice."""
    return field.nullable or not (field.fields or (field.entry and field.entry.fields and not field.range()))


def _row(key: str, field: Shape, joint: str, *, required: bool) -> str:
    name = key if required else f"{key}: {_default(field)}"
    kind = field.words().removesuffix(" or null")
    change = _change(field)
    kind = kind.replace("a list of ", "list of ")
    limits = re.sub(r"from (\S+) to (\S+)", r"\1..\2", field.range())
    limits = re.sub(r"at most (\S+), greater than (\S+)", r">\2..\1", limits)
    limits = _UNSAID.sub("", limits).strip(", ")
    facts = [kind if kind not in _OBVIOUS else "", limits, change if change != joint else ""]
    brackets = f" ({'; '.join(filter(None, facts))})" if any(facts) else ""
    meaning = _prose(field.description)
    return f"| `{name}` | {meaning.removesuffix('.')}{brackets}{'.' if meaning else ''} |\n"


def _change(field: Shape) -> str:
    """What a change of the key takes; of a section, its keys say it."""
    change, weaker = (field.said("change") or "").removeprefix("needs "), field.said("weaker")
    if field.fields or (field.entry and field.entry.fields and field.type == "object"):
        return change if field.nullable else ""
    if weaker in (None, NEITHER):
        return change
    return f"{change}, weaker if {'milder' if set(field.choices) & set(REACTIONS) else weaker}"


def _default(field: Shape) -> str:
    value = field.schema.get("default")
    if isinstance(value, dict) and field.discriminator:
        value = {field.discriminator: value[field.discriminator]}
    return json.dumps(value, ensure_ascii=False)


def _prose(text: str) -> str:
    """Text in which Markdown sees neither a table's bar nor an HTML tag."""
    return text.replace("|", "\\|").replace("<", "\\<")


if __name__ == "__main__":
    sys.stdout.write(render())
