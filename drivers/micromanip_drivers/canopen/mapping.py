"""Which objects a PDO carries, and when: from the EDS, or as the configuration maps it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from canopen.objectdictionary import ODVariable, datatypes

from micromanip.driver import ConfigError

from .dictionary import Dictionary, number
from .options import Rpdo, Tpdo

Direction = Literal["tpdo", "rpdo"]
PARAMETERS = {"tpdo": 0x1800, "rpdo": 0x1400}
MAPPINGS = {"tpdo": 0x1A00, "rpdo": 0x1600}

INVALID = 1 << 31
"""Bit of a PDO's COB-ID: it is switched off."""
EXTENDED = 1 << 29
EVENT = 255

_BITS = 64
_COMMUNICATION = range(0x1000, 0x2000)
_WEARS_OUT = {0x1010: "store parameters", 0x1011: "restore parameters"}


@dataclass(frozen=True)
class Mapped:
    """An object in a PDO."""

    variable: ODVariable
    first_bit: int
    bits: int

    @property
    def entry(self) -> int:
        """The word that stands for it in the mapping."""
        return self.variable.index << 16 | self.variable.subindex << 8 | self.bits


@dataclass(frozen=True)
class Mapping:
    """A PDO: its identifier, when it goes, what it carries."""

    direction: Direction
    number: int
    identifier: int
    transmission: int
    """0 to 240: with SYNC; 254, 255: by an event."""
    objects: tuple[Mapped, ...]
    to_write: bool
    """The mapping is ours, not the EDS's."""
    transmission_to_write: bool

    @property
    def parameters(self) -> int:
        """Index of the object with its communication parameters."""
        return PARAMETERS[self.direction] + self.number - 1

    @property
    def mappings(self) -> int:
        """Index of the object with its mapping."""
        return MAPPINGS[self.direction] + self.number - 1

    @property
    def length(self) -> int:
        """Bytes of its frame."""
        return (sum(mapped.bits for mapped in self.objects) + 7) // 8

    @property
    def synchronous(self) -> bool:
        """True if it goes, or comes into force, with SYNC."""
        return self.transmission <= 240


def mapping(dictionary: Dictionary, direction: Direction, pdo: int, options: Tpdo | Rpdo) -> Mapping:
    """PDO number `pdo` of a node. Raises ConfigError where EDS and configuration don't make a PDO that can work."""
    parameters, mappings = PARAMETERS[direction] + pdo - 1, MAPPINGS[direction] + pdo - 1
    for index in (parameters, mappings):
        if index not in dictionary.objects:
            have = [n for n in range(1, 513) if PARAMETERS[direction] + n - 1 in dictionary.objects]
            hint = f"it has {direction} {', '.join(map(str, have))}" if have else f"it has no {direction}"
            raise ConfigError(f"{dictionary.file} has no {direction} {pdo} (object {index:04X}); {hint}")
    cob_id = dictionary.value(parameters, 1)
    if cob_id & EXTENDED or not 0x180 <= cob_id & 0x1FFFFFFF <= 0x57F:
        raise ConfigError(
            f"{dictionary.file}: {number(parameters, 1)} is 0x{cob_id:X}, which is no identifier of a PDO"
        )
    if cob_id & INVALID and options.map is None:
        raise ConfigError(f"{dictionary.file} has {direction} {pdo} switched off: give it a map")
    transmission = _transmission(options)
    return Mapping(
        direction,
        pdo,
        cob_id & 0x7FF,
        dictionary.value(parameters, 2) if transmission is None else transmission,
        _mapped(dictionary, direction, pdo, options),
        options.map is not None,
        transmission is not None,
    )


def _transmission(options: Tpdo | Rpdo) -> int | None:
    if options.transmission == "event":
        return EVENT
    return 1 if options.transmission == "sync" else options.transmission


def _mapped(dictionary: Dictionary, direction: Direction, pdo: int, options: Tpdo | Rpdo) -> tuple[Mapped, ...]:
    """The objects in their order."""
    where = f"{dictionary.file}, {direction} {pdo}"
    objects: list[Mapped] = []
    bit = 0
    for variable, bits in _listed(dictionary, direction, pdo, options.map):
        what = f"{number(variable.index, variable.subindex)} ({variable.name})"
        _permit(variable, what, direction, where)
        if bits != _width(variable):
            raise ConfigError(f"{where}: {what} is mapped with {bits} bits, its data type has {_width(variable)}")
        objects.append(Mapped(variable, bit, bits))
        bit += bits
    if bit > _BITS:
        raise ConfigError(f"{where} carries {(bit + 7) // 8} bytes; a PDO has room for 8")
    if not objects:
        raise ConfigError(f"{where} carries nothing: give it a map")
    return tuple(objects)


def _listed(
    dictionary: Dictionary, direction: Direction, pdo: int, names: tuple[str, ...] | None
) -> list[tuple[ODVariable, int]]:
    if names is not None:
        return [(variable, _width(variable)) for variable in map(dictionary.find, names)]
    index = MAPPINGS[direction] + pdo - 1
    entries = [dictionary.value(index, i + 1) for i in range(dictionary.value(index, 0))]
    return [(dictionary.variable(entry >> 16, entry >> 8 & 0xFF), entry & 0xFF) for entry in entries]


def _permit(variable: ODVariable, what: str, direction: Direction, where: str) -> None:
    if variable.index < 0x20:
        return
    if direction == "rpdo" and variable.index in _COMMUNICATION:
        wear = _WEARS_OUT.get(variable.index)
        why = f"it would {wear} at each write and wear out the device's memory" if wear else "it is no process data"
        raise ConfigError(f"{where}: {what} is not written cyclically: {why}")
    if not variable.pdo_mappable:
        raise ConfigError(f"{where}: {what} can't be in a PDO (PDOMapping=0)")
    if variable.data_type not in (*datatypes.NUMBER_TYPES, datatypes.BOOLEAN):
        raise ConfigError(f"{where}: {what} is of data type 0x{variable.data_type or 0:X}, which is no number")
    if direction == "rpdo" and not variable.writable:
        raise ConfigError(f"{where}: {what} is read only: an rpdo writes to the node, a tpdo comes from it")


def _width(variable: ODVariable) -> int:
    return 1 if variable.data_type == datatypes.BOOLEAN else len(variable)
