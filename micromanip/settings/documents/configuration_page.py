"""The configuration reference in Markdown, generated from the models.

``make docs`` writes ``docs/configuration.md`` from it; a test compares the two.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator

from micromanip.settings.schema.faults import REACTIONS
from micromanip.settings.schema.key import NEITHER
from micromanip.settings.schema.model import Configuration
from micromanip.settings.text import units
from micromanip.settings.text.shape import Shape

_INTRODUCTION = """\
# Configuration reference

Generated from `micromanip/settings/schema/` by `make docs`; edit the descriptions there.

The file is YAML 1.2: `1e-3` is a number; `on`, `yes` and `no` are text, the truth values are `true` and `false`. A
value's unit stands in its key and never beside the number. An unknown or repeated key is an error. `null` means "none"
or "no limit", where the type allows it; infinity and NaN are refused. Anchors and merge keys (`&tuned`, `<<: *tuned`)
save repetition between axes.

`<name>` stands for a name of your choice, `[i]` for an entry of a list.

"Change" is what a change of the value takes while the controller runs ([Tuning a running cell](tuning-live.md)): live,
it is applied at a cycle boundary; "needs disarm", only with the outputs at rest; "needs restart", only by a new start.
A value that protects less than the present one needs disarm, too: "weaker if larger" says which one it is.
"""
_COLUMNS = ("Key", "Type", "Unit", "Default", "Range", "Change", "Meaning")
_CHANGE = _COLUMNS.index("Change")


def render() -> str:
    """The whole reference."""
    shape = Shape.of(Configuration)
    return "\n".join([_INTRODUCTION, f"## The whole file\n\n{_table(shape)}", *sections(shape)])


def sections(shape: Shape, within: str = "") -> list[str]:
    """The sections of all keys of a model, nested ones too; `within` is the path of the model."""
    written: dict[tuple[str, ...], str] = {}
    return [
        _section(path, section, written)
        for key, field in shape.fields.items()
        for path, section in _sections(f"{within}{key}", field)
    ]


def section(path: str, shape: Shape) -> str:
    """One section: heading, what it is, a table of its keys."""
    return _section(path, shape, {})


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
    heading = f"{'###' if '.' in path.replace('.<name>', '') else '##'} `{path}`\n\n{_prose(shape.description)}\n\n"
    kind = (shape.title, *shape.fields)
    if earlier := written.get(kind):
        return f"{heading}Keys as in `{earlier}`.\n"
    written[kind] = path
    return heading + _table(shape)


def _table(shape: Shape) -> str:
    rows: list[tuple[str, ...]] = [_COLUMNS]
    for key, field in shape.fields.items():
        unit = units.words_for(key) or ""
        default = "required" if key in shape.required else _default(field)
        rows.append(
            (f"`{key}`", field.words(), unit, default, field.range(), _change(field), _prose(field.description))
        )
    if not any(row[_CHANGE] for row in rows[1:]):  # a driver's own options, or nothing but sections
        rows = [row[:_CHANGE] + row[_CHANGE + 1 :] for row in rows]
    header, *lines = (f"| {' | '.join(row)} |\n" for row in rows)
    return f"{header}|{'---|' * len(rows[0])}\n{''.join(lines)}"


def _change(field: Shape) -> str:
    """What a change of the key takes; of a section, its keys say it."""
    change, weaker = field.said("change") or "", field.said("weaker")
    if field.fields or (field.entry and field.entry.fields and field.type == "object"):
        return change if field.nullable else ""
    if weaker in (None, NEITHER):
        return change
    return f"{change}, weaker if {'milder' if set(field.choices) & set(REACTIONS) else weaker}"


def _default(field: Shape) -> str:
    value = field.schema.get("default")
    if isinstance(value, dict):
        return f"`{field.discriminator}: {value[field.discriminator]}`" if field.discriminator else "all its defaults"
    return f"`{json.dumps(value, ensure_ascii=False).strip(chr(34))}`"


def _prose(text: str) -> str:
    """Text in which Markdown sees neither a table's bar nor an HTML tag."""
    return text.replace("|", "\\|").replace("<", "\\<")


if __name__ == "__main__":
    sys.stdout.write(render())
