"""What a model accepts at one place of the file, in words: "a number greater than 0".

It is read from the model's JSON schema, which pydantic derives from the same types that it validates with; so the error
messages and the reference in ``docs/`` say what is really enforced, for a driver's own model too.
"""

from __future__ import annotations

import functools
import json
import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

from pydantic import BaseModel
from pydantic.json_schema import GenerateJsonSchema, JsonSchemaValue

_NOUNS = {
    "number": ("a number", "numbers"),
    "integer": ("a whole number", "whole numbers"),
    "boolean": ("true or false", "true or false each"),
    "string": ("text", "texts"),
    "object": ("a section", "sections"),
}
_SAID = ("change", "weaker")
"""What a section says counts for its keys, too (`micromanip.settings.schema.key`)."""
_COUNTED = {"Items": ("entry", "entries"), "Properties": ("entry", "entries"), "Length": ("character", "characters")}


class _Tolerant(GenerateJsonSchema):
    """Types that JSON can't express (in a driver's model) are left open instead of failing."""

    ignored_warning_kinds = {"skipped-choice", "non-serializable-default"}  # noqa: RUF012

    def handle_invalid_for_json_schema(self, *_: object) -> JsonSchemaValue:
        return {}


@functools.cache
def _schema(model: type[BaseModel]) -> Mapping[str, Any]:
    return model.model_json_schema(schema_generator=_Tolerant)


@dataclass(frozen=True)
class Shape:
    """One place of the file: a section, a list or a value."""

    schema: Mapping[str, Any]
    definitions: Mapping[str, Mapping[str, Any]]
    nullable: bool = False

    @classmethod
    def of(cls, model: type[BaseModel]) -> Shape:
        """Shape of a whole section."""
        schema = _schema(model)
        return cls(schema, schema.get("$defs", {}))._resolved()

    def _resolved(self) -> Shape:
        """Follow a reference and unwrap "or null"; what stands beside them (description, default) wins."""
        rest = dict(self.schema)
        if name := rest.pop("$ref", None):
            target = name.rsplit("/", 1)[-1]
            return Shape({**self.definitions[target], **rest}, self.definitions, self.nullable)._resolved()
        variants = [variant for variant in rest.pop("anyOf", ()) if variant.get("type") != "null"]
        if len(variants) == 1:
            return Shape({**variants[0], **rest}, self.definitions, nullable=True)._resolved()
        return self

    def _part(self, schema: Mapping[str, Any] | bool) -> Shape:
        said = {word: self.schema[word] for word in _SAID if word in self.schema}
        return Shape({**said, **({} if isinstance(schema, bool) else schema)}, self.definitions)._resolved()

    @property
    def description(self) -> str:
        """Of the field, or of the section's class."""
        return " ".join(str(self.schema.get("description", "")).split())

    @property
    def title(self) -> str:
        """Name of the section's class."""
        return str(self.schema.get("title", ""))

    def said(self, word: str) -> str | None:
        """What is said at the field, or at the section around it, of a `change` or of what is `weaker`."""
        return self.schema.get(word)

    @property
    def type(self) -> str | None:
        """JSON's word for it: number, integer, boolean, string, array, object; None where several fit."""
        return self.schema.get("type")

    @property
    def required(self) -> frozenset[str]:
        """Keys that must be there."""
        return frozenset(self.schema.get("required", ()))

    @property
    def choices(self) -> list[object]:
        """The only values allowed, if they are listed."""
        return [self.schema["const"]] if "const" in self.schema else list(self.schema.get("enum", ()))

    @property
    def fields(self) -> dict[str, Shape]:
        """Keys of a section with fixed keys."""
        return {key: self._part(schema) for key, schema in self.schema.get("properties", {}).items()}

    @property
    def entry(self) -> Shape | None:
        """What each entry of a list, or of a section with free names, is."""
        for keyword in ("items", "additionalProperties"):
            if isinstance(schema := self.schema.get(keyword), Mapping):
                return self._part(schema)
        for schema in self.schema.get("patternProperties", {}).values():  # names with a form of their own
            return self._part(schema)
        entries = self.schema.get("prefixItems", ())
        return self._part(entries[0]) if entries else None

    @property
    def variants(self) -> list[Shape]:
        """The alternatives of a union."""
        return [self._part(schema) for schema in self.schema.get("oneOf", self.schema.get("anyOf", ()))]

    @property
    def discriminator(self) -> str | None:
        """The key whose value says which alternative a section is."""
        name: str | None = self.schema.get("discriminator", {}).get("propertyName")
        return name

    @property
    def tags(self) -> Shape:
        """What the discriminator can be."""
        key = str(self.discriminator)
        return self._part({"enum": [tag for variant in self.variants for tag in variant.fields[key].choices]})

    def child(self, part: str | int) -> Shape:
        """What belongs at a key or an index."""
        if isinstance(part, int) and part < len(entries := self.schema.get("prefixItems", ())):
            return self._part(entries[part])
        fields = self.schema.get("properties", {})
        return self._part(fields[part]) if part in fields else self.entry or self._part({})

    def at(self, path: Iterable[str | int]) -> Shape:
        """What belongs at a key path; of a union, in the first alternative that has the key."""
        shape = self
        for part in path:
            holders = (each for each in (shape, *shape.variants) if part in each.schema.get("properties", ()))
            shape = next(holders, shape).child(part)
        return shape

    def words(self, *, many: bool = False) -> str:
        """The type in words."""
        text = self._words(many=many)
        return f"{text} or null" if self.nullable else text

    def _words(self, *, many: bool) -> str:
        if self.choices:
            return either(map(_plain, self.choices))
        if self.discriminator:
            return f"{_NOUNS['object'][many]} with {self.discriminator}: {self.tags.words()}"
        if self.variants:
            return either(dict.fromkeys(variant.words(many=many) for variant in self.variants))
        if self.type == "array":
            low, high = self.schema.get("minItems"), self.schema.get("maxItems")
            number = f"{high} " if low == high is not None else ""
            entries = self.entry.words(many=True) if self.entry else "values"
            return f"{'lists' if many else 'a list'} of {number}{entries}"
        return _NOUNS.get(self.type or "", ("a value", "values"))[many]

    def range(self) -> str:
        """Limits of the value, of a list's entries, and of their number, in words; empty without any."""
        limits = _limits(self.schema.get("minimum"), self.schema.get("maximum"))
        for keyword, words in (("exclusiveMinimum", "greater than"), ("exclusiveMaximum", "less than")):
            if keyword in self.schema:
                limits.append(f"{words} {_plain(self.schema[keyword])}")
        if self.type == "array" and self.entry and (each := self.entry.range()):
            limits.append(f"each {each}")
        return ", ".join(limits + self._size())

    def allows(self, number: float) -> bool:
        """Whether `number` is neither below the least nor above the greatest value."""
        return bool(self.schema.get("minimum", -math.inf) <= number <= self.schema.get("maximum", math.inf))

    def _size(self) -> list[str]:
        if self.type == "array" and self.schema.get("minItems") == self.schema.get("maxItems"):
            return []  # words() has it: "a list of 2 numbers"
        sizes = []
        for kind, (one, many) in _COUNTED.items():
            low, high = self.schema.get(f"min{kind}"), self.schema.get(f"max{kind}")
            noun = one if (high or low) == 1 else many
            sizes += [f"{limits} {noun}" for limits in _limits(low, high)]
        return sizes

    def expected(self) -> str:
        """Type and range in one phrase, for a message."""
        limits = self.range()
        joint = ", " if self.type in ("array", "object") else " "
        return f"{self._words(many=False)}{joint if limits else ''}{limits}{' or null' if self.nullable else ''}"


def either(words: Iterable[str]) -> str:
    """``a, b or c``."""
    *first, last = words
    return f"{', '.join(first)} or {last}" if first else last


def _limits(low: float | None, high: float | None) -> list[str]:
    if low is not None and high is not None:
        return [f"from {_plain(low)} to {_plain(high)}"]
    return [f"at least {_plain(low)}"] * (low is not None) + [f"at most {_plain(high)}"] * (high is not None)


def _plain(value: object) -> str:
    if isinstance(value, str):
        return value if value.isprintable() else json.dumps(value)  # a line's end among what a text may be
    return f"{value:g}" if isinstance(value, float) and abs(value) < 1e6 else str(value)
