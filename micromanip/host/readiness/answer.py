"""The answer of ``micromanip system check``: machine, findings, timed run, and whether hardware may be run on it."""

from __future__ import annotations

import importlib.metadata
import os
import platform
import re
import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from micromanip.settings.schema.model import Loop

from .finding import Finding, Machine, Verdict
from .kernel import kernel_findings
from .network import network_findings
from .processor import processor_findings
from .rights import rights_findings
from .timed import Timed


@dataclass(frozen=True)
class Answer:
    """`timed` is None where nothing was run."""

    machine: dict[str, Any]
    findings: tuple[Finding, ...]
    timed: Timed | None

    @property
    def ready(self) -> bool | None:
        """Whether hardware may be run: nothing is bad, and no deadline was missed; None where nothing was timed."""
        if any(finding.verdict is Verdict.BAD for finding in self.findings):
            return False
        if self.timed is None:
            return None
        return self.timed.keeps_its_deadlines and not self.timed.under_load.refused

    @property
    def verdict(self) -> str:
        """The answer in one sentence, with how it is known."""
        bad = [finding.name for finding in self.findings if finding.verdict is Verdict.BAD]
        poor = sum(finding.verdict is Verdict.POOR for finding in self.findings)
        if bad:
            return f"NOT READY: {', '.join(bad)}"
        if self.timed is None:
            return f"NOT MEASURED: nothing was run; {poor} settings are poor"
        rest, load = self.timed.at_rest, self.timed.under_load
        counted = (
            f"{rest.overruns} overruns in {rest.cycles} cycles at rest, {load.overruns} in {load.cycles} under load"
        )
        if load.refused:
            return f"NOT READY: {'; '.join(text.partition(':')[0] for text in load.refused)}"
        if not self.ready:
            return f"NOT READY: {counted}"
        remark = f"; {poor} settings are poor, and may show in a longer run" if poor else ""
        return f"READY for the {self.timed.seconds:g} s that were measured: {counted}{remark}"

    def document(self) -> dict[str, Any]:
        """As JSON has it."""
        return {
            "ready": self.ready,
            "verdict": self.verdict,
            "machine": self.machine,
            "findings": [finding.document() for finding in self.findings],
            "timed": None if self.timed is None else self.timed.document(),
        }


def machine_and_loop(machine: Machine, loop: Loop) -> dict[str, Any]:
    """Which machine, kernel and release the answer is about, and how the loop would run."""
    model = re.search(r"^model name\s*:\s*(.*)$", machine.read("proc/cpuinfo") or "", re.MULTILINE)
    return {
        "time": time.strftime("%Y-%m-%d %H:%M:%S%z"),
        "name": platform.node(),
        "processor": model[1] if model else platform.machine(),
        "cpus": os.cpu_count(),
        "kernel": f"{platform.release()} {platform.version()}",
        "command_line": machine.read("proc/cmdline"),
        "micromanip": importlib.metadata.version("micromanip"),
        "loop": loop.model_dump(mode="json"),
    }


def looked_at(machine: Machine, loop: Loop, interfaces: Sequence[str] = ()) -> tuple[Finding, ...]:
    """Every setting of `machine` that matters to `loop`, which itself serves wires at these network interfaces."""
    kernel = kernel_findings(machine, platform.release(), platform.version(), 1e6 / loop.rate_hz, loop.spin_us)
    processor = processor_findings(machine, loop.cpu, os.sched_getaffinity(0))
    network = network_findings(machine, interfaces, loop.cpu, loop.priority)
    return (*kernel, *processor, *network, *rights_findings(loop.priority, hardware=loop.limits == "hardware"))
