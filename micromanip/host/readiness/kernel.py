"""The kernel that schedules the loop: preemption, clock, throttling, virtualisation, memory."""

from __future__ import annotations

import re

from .finding import Finding, Machine, Verdict

_FAST_CLOCKS = {"tsc", "arch_sys_counter", "kvm-clock", "hyperv_clocksource_tsc_page", "riscv_clocksource"}
"""Read without leaving the process; hpet and acpi_pm take a microsecond each time."""
_SPARE = 0.05
"""Share of the time that the cycle itself may take beside the spinning."""


def kernel_findings(machine: Machine, release: str, version: str, period_us: float, spin_us: float) -> list[Finding]:
    """`release` and `version` as uname(2) has them; a loop of `period_us` spins `spin_us` of each period."""
    return [
        _preemption(machine, release, version),
        _clock(machine),
        _throttling(machine, spin_us / period_us),
        _virtual(machine),
        _huge_pages(machine),
    ]


def _preemption(machine: Machine, release: str, version: str) -> Finding:
    is_rt = machine.read("sys/kernel/realtime") == "1" or "PREEMPT_RT" in version
    kind = re.search(r"PREEMPT\w*", version)
    found = f"{release}, {'PREEMPT_RT' if is_rt else kind[0] if kind else 'without preemption'}"
    why = "without PREEMPT_RT, code of the kernel that can't be interrupted holds the loop up for hundreds of us"
    return Finding.of("kernel", found, why, None if is_rt else "sudo apt-get install linux-image-rt-amd64, then reboot")


def _clock(machine: Machine) -> Finding:
    clock = machine.read("sys/devices/system/clocksource/clocksource0/current_clocksource")
    why = "the loop watches the clock while it spins; a slow one takes a microsecond to read, and jumps"
    mend = "`dmesg | grep -i tsc` says why the kernel gave the fast one up; mostly a new BIOS mends it"
    return Finding.of("clock", clock, why, None if clock in _FAST_CLOCKS else mend)


def _throttling(machine: Machine, spun: float) -> Finding:
    runtime, period = (machine.read(f"proc/sys/kernel/sched_rt_{name}_us") for name in ("runtime", "period"))
    why = "the kernel takes the CPU from real-time processes that use more than this share of each second"
    if runtime is None or period is None:
        return Finding.of("throttling", None, why)
    share = int(runtime) / int(period)
    found = "off" if share < 0 else f"{share:.0%} allowed, {spun:.0%} are spun"
    if share < 0 or spun + _SPARE < share:
        return Finding.of("throttling", found, why)
    mend = "lower loop.spin_us, or: sudo sysctl kernel.sched_rt_runtime_us=-1 (and a file in /etc/sysctl.d)"
    return Finding("throttling", Verdict.BAD, found, why, mend)


def _virtual(machine: Machine) -> Finding:
    why = "whoever runs a virtual machine takes its CPUs away at any time, and nothing in it can forbid that"
    information = machine.read("proc/cpuinfo")
    if information is None:
        return Finding.of("hardware", None, why)
    if not re.search(r"^flags\s*:.*\bhypervisor\b", information, re.MULTILINE):
        return Finding.of("hardware", "no hypervisor is announced", why)
    mend = "run the cell on a computer of its own; this one does for simulations"
    return Finding.of("hardware", "a virtual machine", why, mend)


def _huge_pages(machine: Machine) -> Finding:
    why = "a kernel that joins pages together in the background holds the memory that it works on"
    chosen = re.search(r"\[(\w+)\]", machine.read("sys/kernel/mm/transparent_hugepage/enabled") or "")
    found = chosen and chosen[1]
    mend = "kernel parameter transparent_hugepage=madvise, then reboot" if found == "always" else None
    return Finding.of("huge pages", found, why, mend)
