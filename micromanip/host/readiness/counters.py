"""What the kernel counted on the loop's CPU, and for its process, while it ran."""

from __future__ import annotations

import os
import struct
from dataclasses import dataclass

from .finding import Machine
from .processor import interrupt_counts

_MSR_SMI_COUNT = 0x34
_STEAL = 8
"""Column of /proc/stat, after the name of the CPU."""
_MINOR, _MAJOR = 9, 11
"""Fields of /proc/PID/stat, counted from 0; page faults without and with a disk (proc(5))."""


@dataclass(frozen=True)
class Counters:
    """Readings at one time; what could not be read is missing."""

    interrupts: dict[str, int]
    """By the description that the kernel gives of each source."""
    others: dict[str, int]

    @classmethod
    def taken(cls, machine: Machine, cpu: int, process: int) -> Counters:
        """Of this moment."""
        interrupts = {
            about.split()[-1] if source.isdigit() and about else about or source: count
            for source, (count, about) in interrupt_counts(machine, cpu).items()
        }
        readings = {**_of_cpu(machine, cpu), **_of_process(machine, process)}
        return cls(interrupts, {name: value for name, value in readings.items() if value is not None})

    def since(self, before: Counters) -> Counters:
        """What was added meanwhile; an interrupt that did not come is left out."""
        interrupts = {name: count - before.interrupts.get(name, 0) for name, count in self.interrupts.items()}
        others = {name: value - before.others[name] for name, value in self.others.items() if name in before.others}
        return Counters({name: count for name, count in interrupts.items() if count > 0}, others)


def _of_cpu(machine: Machine, cpu: int) -> dict[str, int | None]:
    found: dict[str, int | None] = {}
    for line in (machine.read("proc/stat") or "").splitlines():
        name, *columns = line.split()
        if name == f"cpu{cpu}" and len(columns) >= _STEAL:
            found["stolen by the hypervisor, ms"] = int(columns[_STEAL - 1]) * 1000 // os.sysconf("SC_CLK_TCK")
    throttled = machine.read(f"sys/devices/system/cpu/cpu{cpu}/thermal_throttle/core_throttle_count")
    found["slowed down by heat"] = int(throttled) if throttled else None
    found["system management interrupts"] = _smi_count(machine, cpu)
    return found


def _smi_count(machine: Machine, cpu: int) -> int | None:
    """Of Intel's processors, where /dev/cpu/N/msr may be read (module msr, root)."""
    if "GenuineIntel" not in (machine.read("proc/cpuinfo") or ""):
        return None
    try:
        with (machine.root / f"dev/cpu/{cpu}/msr").open("rb", buffering=0) as registers:
            registers.seek(_MSR_SMI_COUNT)
            return int(struct.unpack("<Q", registers.read(8))[0]) & 0xFFFFFFFF
    except (OSError, struct.error):
        return None


def _of_process(machine: Machine, process: int) -> dict[str, int | None]:
    found: dict[str, int | None] = {}
    status = machine.read(f"proc/{process}/status") or ""
    for line in status.splitlines():
        name, _, value = line.partition(":")
        if name == "nonvoluntary_ctxt_switches":
            found["times the loop was displaced"] = int(value)
    # the name in parentheses may hold spaces, and parentheses
    fields = (machine.read(f"proc/{process}/stat") or "").rpartition(")")[2].split()
    if len(fields) > _MAJOR:
        found["page faults of the loop"] = int(fields[_MINOR - 2]) + int(fields[_MAJOR - 2])
    return found
