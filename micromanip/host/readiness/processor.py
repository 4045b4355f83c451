"""The loop's CPU: whether it is its own, awake, at full speed, and left alone by interrupts."""

from __future__ import annotations

import os
import re

from .finding import Finding, Machine, Verdict, cpu_list, listed

_CPUS = "sys/devices/system/cpu"
_SHALLOW_US = 5
"""An idle state that is left within so much is no concern."""
_SHOWN = 4


def processor_findings(machine: Machine, cpu: int | None, allowed: set[int]) -> list[Finding]:
    """Of the CPU `loop.cpu`; `allowed` are those that this process may use. Without one there is little to say."""
    why = "a loop that the scheduler moves about loses its caches, and meets whatever else runs there"
    online = cpu_list(machine.read(f"{_CPUS}/online")) or allowed
    if cpu is None:
        mend = f"set loop.cpu to one of {listed(allowed)}, best the last"
        return [Finding.of("loop's CPU", "loop.cpu is null: any", why, mend)]
    if cpu not in online & allowed:
        there = f"CPU {cpu} is not {'online' if cpu not in online else 'allowed to this process'}"
        mend = f"set loop.cpu to one of {listed(online & allowed)}"
        return [Finding("loop's CPU", Verdict.BAD, there, why, mend)]
    first = Finding.of("loop's CPU", f"CPU {cpu} of {listed(online)}", why)
    if len(online) == 1:
        mend = "take a computer with two CPUs at least"
        first = Finding.of("loop's CPU", "the only one", "the host and all else wait for the loop", mend)
    return [
        first,
        _isolated(machine, cpu),
        _tick(machine, cpu),
        _sibling(machine, cpu),
        _governor(machine, cpu),
        _idle(machine, cpu),
        _interrupts(machine, cpu, online),
    ]


def _isolated(machine: Machine, cpu: int) -> Finding:
    boot = cpu_list(machine.read(f"{_CPUS}/isolated"))
    partition = cpu_list(machine.read("sys/fs/cgroup/cpuset.cpus.isolated"))
    why = "other processes on the loop's CPU leave cold caches, and kernel work bound to it delays the loop"
    if cpu in boot | partition:
        found = f"CPU {cpu} is, by {'the command line' if cpu in boot else 'a cgroup partition'}"
        return Finding.of("isolation", found, why)
    mend = f"kernel parameter isolcpus=managed_irq,domain,{cpu}, then reboot"
    return Finding.of("isolation", f"isolated: {listed(boot | partition)}", why, mend)


def _tick(machine: Machine, cpu: int) -> Finding:
    full = cpu_list(machine.read(f"{_CPUS}/nohz_full"))
    callbacks = cpu_list(machine.parameters().get("rcu_nocbs"))
    why = "the timer tick and RCU callbacks interrupt the loop, each for some microseconds"
    if cpu in full:  # it takes the RCU callbacks elsewhere, too
        return Finding.of("timer tick", f"CPU {cpu} has none while one process runs", why)
    found = "ticks; " + ("no RCU callbacks" if cpu in callbacks else "RCU callbacks run there, too")
    mend = f"kernel parameters nohz_full={cpu} rcu_nocbs={cpu}, then reboot"
    return Finding.of("timer tick", found, why, mend)


def _sibling(machine: Machine, cpu: int) -> Finding:
    siblings = cpu_list(machine.read(f"{_CPUS}/cpu{cpu}/topology/thread_siblings_list"))
    why = "two threads of a core share its units and caches: what runs on the other makes the cycle slower"
    if not siblings:
        return Finding.of("hyper-threading", None, why)
    if not (others := siblings - {cpu}):
        return Finding.of("hyper-threading", "the core has one thread", why)
    mend = f"echo 0 | sudo tee /sys/devices/system/cpu/cpu{min(others)}/online (or off in the BIOS)"
    return Finding.of("hyper-threading", f"shares its core with CPU {listed(others)}", why, mend)


def _governor(machine: Machine, cpu: int) -> Finding:
    folder = f"{_CPUS}/cpu{cpu}/cpufreq"
    governor, lowest, highest = (
        machine.read(f"{folder}/scaling_{name}") for name in ("governor", "min_freq", "max_freq")
    )
    why = "a clock that is lowered while little is to do doubles the cycle's time, and takes time to come back"
    if governor is None:
        return Finding("frequency", Verdict.UNKNOWN, "not to be seen: the firmware or a host decides", why)
    if governor == "performance" or (lowest is not None and lowest == highest):
        return Finding.of("frequency", f"governor {governor}", why)
    mend = f"sudo cpupower -c {cpu} frequency-set -g performance (Debian package linux-cpupower), at each start"
    return Finding.of("frequency", f"governor {governor}", why, mend)


def _idle(machine: Machine, cpu: int) -> Finding:
    why = "a CPU takes up to hundreds of us to come out of a deep idle state"
    folder, deep = f"{_CPUS}/cpu{cpu}/cpuidle", []
    states = machine.listed(folder, "state*")
    for state in states:
        name, latency, disabled = (machine.read(f"{folder}/{state}/{what}") for what in ("name", "latency", "disable"))
        if disabled != "1" and (latency or "").isdigit() and int(latency or 0) > _SHALLOW_US:
            deep.append(f"{name} ({latency} us)")
    if not states:
        return Finding("idle states", Verdict.UNKNOWN, "not to be seen: the firmware or a host decides", why)
    if not deep:
        return Finding.of("idle states", "none takes long to leave", why)
    found = ", ".join(deep)
    if os.access(machine.root / "dev/cpu_dma_latency", os.W_OK):
        return Finding.of("idle states", f"{found}; the loop forbids them while it runs", why)
    mend = f"let the loop's user write /dev/cpu_dma_latency (the unit does), or: sudo cpupower -c {cpu} idle-set -D 5"
    return Finding.of("idle states", found, why, mend)


def _interrupts(machine: Machine, cpu: int, online: set[int]) -> Finding:
    why = "an interrupt of a disk or network card on the loop's CPU stops the loop for as long as its handler takes"
    if not (counts := _interrupt_counts(machine, cpu)):
        return Finding.of("interrupts", None, why)
    rows = {
        source: about.split()[-1] for source, (count, about) in counts.items() if source.isdigit() and count and about
    }
    if not rows:
        return Finding.of("interrupts", f"no device has interrupted CPU {cpu}", why)
    placed = {
        source: cpu_list(
            machine.read(f"proc/irq/{source}/effective_affinity_list")
            or machine.read(f"proc/irq/{source}/smp_affinity_list")
        )
        for source in rows
    }
    still = [source for source, cpus in placed.items() if cpu in cpus]
    if not still:
        return Finding.of("interrupts", f"no device interrupts CPU {cpu} any more", why)
    shown = ", ".join(f"{source} {rows[source]}" for source in still[:_SHOWN])
    more = f" and {len(still) - _SHOWN} more" if len(still) > _SHOWN else ""
    others = ",".join(map(str, sorted(online - {cpu})))
    mend = (
        f"kernel parameter irqaffinity={others}; now: echo {others} | sudo tee /proc/irq/{still[0]}/smp_affinity_list"
    )
    return Finding.of("interrupts", shown + more, why, mend)


def _interrupt_counts(machine: Machine, cpu: int) -> dict[str, tuple[int, str]]:
    """Count on `cpu` and description of each line of /proc/interrupts that counts by CPU, by its first word."""
    header, *lines = (machine.read("proc/interrupts") or "").splitlines() or [""]
    columns = [int(name[3:]) for name in header.split() if re.fullmatch(r"CPU\d+", name)]
    if cpu not in columns:
        return {}
    found = {}
    for line in lines:
        source, _, rest = line.partition(":")
        words = rest.split(maxsplit=len(columns))
        if len(words) >= len(columns) and all(word.isdigit() for word in words[: len(columns)]):
            about = " ".join(words[len(columns)].split()) if len(words) > len(columns) else ""
            found[source.strip()] = int(words[columns.index(cpu)]), about
    return found
