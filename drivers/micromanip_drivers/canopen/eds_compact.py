"""Objects whose parts an EDS or a DCF does not list one by one (CompactSubObj, CiA 306), as if it had listed them.

canopen knows arrays only that are written so, and leaves out what their parts are set to (``[1600Value]``).
"""

from __future__ import annotations

from collections.abc import Mapping

_UNSIGNED8, _MOST = 5, 254
_OF_EACH = ("DataType", "AccessType", "PDOMapping", "LowLimit", "HighLimit", "DefaultValue", "Unit", "Factor")


def whole(sections: Mapping[str, Mapping[str, str]]) -> dict[str, Mapping[str, str]]:
    """Keys and values of each section, by its name; those of compact objects have become sections of their parts."""
    listed: dict[str, Mapping[str, str]] = {}
    for name, values in sections.items():
        if name.endswith(("Name", "Value")):
            continue
        listed[name] = values
        if "CompactSubObj" in values and "sub" not in name:
            names, set_to = (_by_subindex(sections.get(name + of_parts, {})) for of_parts in ("Name", "Value"))
            listed[name] = {key: value for key, value in values.items() if key != "CompactSubObj"}
            last = min(int(values["CompactSubObj"]), _MOST)
            listed[f"{name}sub0"] = _count(last)
            for k in range(1, last + 1):
                part = {key: values[key] for key in _OF_EACH if key in values}
                part["ParameterName"] = names.get(k, f"{values['ParameterName']}_{k:x}")
                if k in set_to:
                    part["ParameterValue"] = set_to[k]
                listed[f"{name}sub{k:X}"] = part
    return listed | {name: values for name, values in sections.items() if "sub" in name}


def _by_subindex(values: Mapping[str, str]) -> dict[int, str]:
    return {int(key): value for key, value in values.items() if key.isascii() and key.isdigit() and value}


def _count(last: int) -> Mapping[str, str]:
    return {
        "ParameterName": "Number of entries",
        "DataType": str(_UNSIGNED8),
        "AccessType": "ro",
        "DefaultValue": str(last),
    }
