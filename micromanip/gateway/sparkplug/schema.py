"""The payload of Sparkplug B as messages of protobuf, from the field numbers of the specification (3.0, chapter 6.4).

What we neither send nor look at (data sets, templates, metadata) is left out: protobuf skips fields that it does not
know. The descriptor is built here, as a table, so that no generated code is tied to one release of protobuf; it has a
pool of its own, beside whatever else has these messages.
"""

from __future__ import annotations

from typing import Any

from google.protobuf import descriptor_pb2, descriptor_pool, message_factory

INT64, DOUBLE, BOOLEAN, STRING = 4, 10, 11, 12
"""Data types of a metric, by their numbers in the specification."""

_PACKAGE = "micromanip.sparkplug"
_TABLE: dict[str, list[tuple[int, str, str]]] = {
    "Payload": [(1, "timestamp", "uint64"), (2, "metrics", "Metric*"), (3, "seq", "uint64")],
    "Metric": [
        (1, "name", "string"),
        (2, "alias", "uint64"),
        (3, "timestamp", "uint64"),
        (4, "datatype", "uint32"),
        (7, "is_null", "bool"),
        (9, "properties", "PropertySet"),
        (11, "long_value", "uint64"),
        (13, "double_value", "double"),
        (14, "boolean_value", "bool"),
        (15, "string_value", "string"),
    ],
    "PropertySet": [(1, "keys", "string*"), (2, "values", "PropertyValue*")],
    "PropertyValue": [(1, "type", "uint32"), (8, "string_value", "string")],
}
_ONE_OF = {"Metric": "value", "PropertyValue": "value"}
"""Messages whose fields that end in `_value` exclude one another."""


def _described() -> Any:
    kinds = descriptor_pb2.FieldDescriptorProto
    file = descriptor_pb2.FileDescriptorProto(name="micromanip/sparkplug.proto", package=_PACKAGE, syntax="proto2")
    for name, fields in _TABLE.items():
        message = file.message_type.add(name=name)
        if name in _ONE_OF:
            message.oneof_decl.add(name=_ONE_OF[name])
        for number, called, kind in fields:
            label = kinds.LABEL_REPEATED if kind.endswith("*") else kinds.LABEL_OPTIONAL
            field = message.field.add(name=called, number=number, label=label)
            if kind.rstrip("*") in _TABLE:
                field.type, field.type_name = kinds.TYPE_MESSAGE, f".{_PACKAGE}.{kind.rstrip('*')}"
            else:
                field.type = kinds.Type.Value(f"TYPE_{kind.rstrip('*').upper()}")
            if name in _ONE_OF and called.endswith("_value"):
                field.oneof_index = 0
    return file


_pool = descriptor_pool.DescriptorPool()
_pool.Add(_described())
Payload: Any = message_factory.GetMessageClass(_pool.FindMessageTypeByName(f"{_PACKAGE}.Payload"))
"""A whole message."""
