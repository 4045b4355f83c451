"""The network card of a wire that the loop serves: driver, coalescing, and who takes its interrupts."""

from __future__ import annotations

import re
import subprocess
from collections.abc import Callable, Sequence

from .finding import Finding, Machine, Verdict, cpu_list, listed

_HOLDS_BACK = ("rx-usecs", "tx-usecs")
_RT_PRIORITY = 37
"""Of the fields of /proc/PID/stat behind the name."""


def ethtool(interface: str) -> str | None:
    """What ``ethtool -c`` says; None where it is not there, or the card has nothing to say."""
    try:
        done = subprocess.run(["ethtool", "-c", interface], capture_output=True, text=True, timeout=5, check=False)
    except (OSError, subprocess.TimeoutExpired):
        return None
    return done.stdout if done.returncode == 0 else None


def network_findings(
    machine: Machine,
    interfaces: Sequence[str],
    cpu: int | None,
    priority: int,
    coalescing: Callable[[str], str | None] = ethtool,
) -> list[Finding]:
    """Of each interface; `cpu` and `priority` are the loop's."""
    found: list[Finding] = []
    for interface in interfaces:
        place = f"sys/class/net/{interface}"
        if machine.read(f"{place}/ifindex") is None:
            why = "the loop sends its frames there"
            mend = f"ip link lists what there is; put the card in, or name another one than {interface}"
            found.append(Finding.of(f"{interface}: card", "not there", why, mend))
            continue
        found.append(_driver(machine, interface, place))
        if machine.listed(place, "device"):
            found += [_coalescing(interface, coalescing(interface)), _interrupts(machine, interface, cpu, priority)]
    return found


def _driver(machine: Machine, interface: str, place: str) -> Finding:
    why = "drivers differ in how long they keep a frame: igb, igc and e1000e are known to send and to deliver at once"
    driver = next((driver.removeprefix("DRIVER=") for driver in _uevent(machine, place)), None)
    if driver is None:
        return Finding(f"{interface}: driver", Verdict.UNKNOWN, "none: no card, but a virtual interface", why)
    where = "on USB" if "usb" in (machine.read(f"{place}/device/modalias") or "") else "not on USB"
    if where == "on USB":
        mend = "take a card on PCI Express"
        why = "a card on USB is asked once in 125 us at best"
        return Finding.of(f"{interface}: driver", f"{driver}, {where}", why, mend)
    return Finding.of(f"{interface}: driver", driver, why)


def _uevent(machine: Machine, place: str) -> list[str]:
    lines = (machine.read(f"{place}/device/uevent") or "").splitlines()
    return [line for line in lines if line.startswith("DRIVER=")]


def _coalescing(interface: str, said: str | None) -> Finding:
    name, why = f"{interface}: coalescing", "a card that gathers frames before it interrupts brings each one late"
    if said is None:
        mend = f"look with ethtool -c {interface} (Debian package ethtool)"
        return Finding(name, Verdict.UNKNOWN, "ethtool is not there, or says nothing", why, mend)
    values = dict(re.findall(r"^([a-z-]+):\s*(\d+)", said, re.MULTILINE))
    holds = [f"{key} {values[key]}" for key in _HOLDS_BACK if int(values.get(key, "0")) > 0]
    adaptive = re.search(r"^Adaptive RX:\s*on", said, re.MULTILINE) is not None
    if not holds and not adaptive:
        return Finding.of(name, "none", why)
    found = ", ".join([*holds, *(["adaptive"] if adaptive else [])])
    mend = f"sudo ethtool -C {interface} {'adaptive-rx off ' if adaptive else ''}rx-usecs 0 tx-usecs 0, on every boot"
    return Finding.of(name, found, why, mend)


def _interrupts(machine: Machine, interface: str, cpu: int | None, priority: int) -> Finding:
    """Threads of its interrupts exist on PREEMPT_RT, or with the kernel parameter threadirqs."""
    name = f"{interface}: interrupts"
    why = "the thread of the card's interrupt brings the frame; below the loop and on its CPU it waits for the loop"
    lines = (machine.read("proc/interrupts") or "").splitlines()
    own = [m[1] for line in lines if (m := re.match(rf"\s*(\d+):.*\b{re.escape(interface)}(?![\w.])", line))]
    if not own:
        return Finding(name, Verdict.UNKNOWN, "none that has its name in /proc/interrupts", why)
    there = set[int]()
    for source in own:
        effective = machine.read(f"proc/irq/{source}/effective_affinity_list")
        there |= cpu_list(effective or machine.read(f"proc/irq/{source}/smp_affinity_list"))
    threads = _threads(machine, own)
    told = f"IRQ {', '.join(own)} on CPU {listed(there)}"
    told += f", threads at FIFO {listed(threads.values())}" if threads else ", no threads"
    low = [number for number, rt_priority in threads.items() if rt_priority <= priority]
    if cpu not in there or (threads and not low):
        return Finding.of(name, told, why)
    if not threads:
        why = "its interrupts stop the loop on the loop's own CPU"
    others = cpu_list(machine.read("sys/devices/system/cpu/online")) - {cpu}
    mend = f"echo {listed(others).replace(' ', '')} | sudo tee /proc/irq/{own[0]}/smp_affinity_list"
    if low:
        mend += f"; or sudo chrt -f -p {min(99, priority + 5)} {low[0]}"
    return Finding.of(name, told, why, mend)


def _threads(machine: Machine, sources: Sequence[str]) -> dict[int, int]:
    """Real-time priority of the thread of each of these interrupts, by its process number."""
    found = {}
    for number in machine.listed("proc", "[0-9]*"):
        name = machine.read(f"proc/{number}/comm") or ""
        if (match := re.match(r"irq/(\d+)-", name)) and match[1] in sources:
            fields = (machine.read(f"proc/{number}/stat") or "").rpartition(")")[2].split()
            if len(fields) > _RT_PRIORITY:
                found[int(number)] = int(fields[_RT_PRIORITY])
    return found
