"""The configuration reference in Markdown, generated from the models.

``make docs`` writes ``docs/configuration.md`` from it; a test compares the two.
"""

from __future__ import annotations

import json
import re
import sys
from collections.abc import Container, Iterator

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

`<name>` stands for a name of your choice, `[i]` for an entry of a list. A key without a default (`-`) is required. A
key whose value is a section with defaults only has no row.

The words in brackets are the range and what a change takes while the controller runs ([Tune](tune.md)). *live*: the
change is applied at a cycle boundary. *disarm*: the outputs must be at rest. *restart*: a new start is needed. A value
that protects less than the present one needs disarm, too: "weaker if larger" says which one it is.
"""
_HEADER = "| Key | Default | Meaning |\n|---|---|---|\n"
_OBVIOUS = ("a number", "a whole number", "true or false", "text", "a section")
"""Types that the default or the meaning shows."""


def render() -> str:
    """The whole reference."""
    shape = Shape.of(Configuration)
    return "\n".join([_INTRODUCTION, f"## The whole file\n\n{table(shape)}", *sections(shape)])


def sections(shape: Shape, within: str = "", written: dict[tuple[str, ...], str] | None = None) -> list[str]:
    """The sections of all keys of a model, nested ones too.

    `within` is the path of the model. `written` has the sections of the page so far, which are not repeated.
    """
    written = {} if written is None else written
    return [
        _section(path, section, written)
        for key, field in shape.fields.items()
        for path, section in _sections(f"{within}{key}", field)
    ]


def _sections(path: str, shape: Shape) -> Iterator[tuple[str, Shape]]:
    """The sections at a path, each variant of a union, and all that are nested in them."""
    if key := shape.discriminator:
        for variant in shape.variants:
            yield from _sections(f"{path} with {key}: {variant.fields[key].words()}", variant)
    elif shape.fields:
        yield path, shape
        bare = path.split(" with ")[0]
        for key, field in shape.fields.items():
            yield from _sections(f"{bare}.{key}", field)
    elif shape.entry:
        yield from _sections(path + ("[i]" if shape.type == "array" else ".<name>"), shape.entry)


def _section(path: str, shape: Shape, written: dict[tuple[str, ...], str]) -> str:
    level = "###" if "." in path.replace(".<name>", "") else "##"
    kind = (shape.title, *shape.fields)
    if earlier := written.get(kind):
        return f"{level} `{path}`\n\nKeys as in `{earlier}`.\n"
    written[kind] = path
    return f"{level} `{path}`\n\n{_prose(shape.description)}\n\n{table(shape)}"


def table(shape: Shape, known: Container[str] = ()) -> str:
    """The keys of a section, each a row but the `known` ones; what all of them need for a change stands above."""
    fields = {key: field for key, field in shape.fields.items() if _has_row(field) and key not in known}
    changes = {_change(field) for field in fields.values()}
    joint = changes.pop() if len(changes) == 1 and len(fields) > 1 else ""
    rows = [_row(key, field, joint, required=key in shape.required) for key, field in fields.items()]
    above = f"Change of each key: {joint}.\n\n" if joint else ""
    return above + _HEADER + "".join(rows) if rows else ""


def _has_row(field: Shape) -> bool:
    """A section follows under its own heading; its row would say nothing more, unless it can be null or is a choice."""
    return field.nullable or not (field.fields or (field.entry and field.entry.fields and not field.range()))


def _row(key: str, field: Shape, joint: str, *, required: bool) -> str:
    default = "-" if required else _default(field)
    kind = field.words().removesuffix(" or null")
    change = _change(field)
    limits = re.sub(r"from (\S+) to (\S+)", r"\1..\2", field.range())
    facts = [kind if kind not in _OBVIOUS else "", limits, change if change != joint else ""]
    brackets = f" ({'; '.join(filter(None, facts))})" if any(facts) else ""
    meaning = _prose(field.description)
    return f"| `{key}` | {default} | {meaning.removesuffix('.')}{brackets}{'.' if meaning else ''} |\n"


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
    if isinstance(value, dict):
        return f"`{field.discriminator}: {value[field.discriminator]}`" if field.discriminator else "`{}`"
    return f"`{json.dumps(value, ensure_ascii=False)}`"


def _prose(text: str) -> str:
    """Text in which Markdown sees neither a table's bar nor an HTML tag."""
    return text.replace("|", "\\|").replace("<", "\\<")


if __name__ == "__main__":
    sys.stdout.write(render())
