"""What is said of a machine's settings, on machines that are not this one."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from micromanip.host.readiness.finding import Verdict, cpu_list
from micromanip.host.readiness.kernel import kernel_findings
from micromanip.host.readiness.processor import processor_findings

from .machines import DESKTOP, TUNED

ALL = {0, 1, 2, 3}


def looked_at(machine, spin_us=60.0, version="#1 SMP PREEMPT_DYNAMIC Debian 6.12.9-1"):
    found = kernel_findings(machine, "6.12.9-amd64", version, 100.0, spin_us) + processor_findings(machine, 3, ALL)
    return {finding.name: finding for finding in found}


def test_a_machine_that_is_set_up_as_the_manual_says_is_good_throughout(machine):
    found = looked_at(machine(TUNED))
    assert {name for name, finding in found.items() if finding.verdict is not Verdict.GOOD} == set()
    assert all(finding.mend is None for finding in found.values())
    assert len(found) == 12


def test_each_setting_of_a_desktop_is_named_with_what_mends_it(machine):
    found = looked_at(machine(DESKTOP))
    poor = {name: finding.mend for name, finding in found.items() if finding.verdict is Verdict.POOR}
    assert poor.keys() == {"kernel", "clock", "hardware", "huge pages", "isolation", "timer tick", "hyper-threading",
                           "frequency", "idle states", "interrupts"}  # fmt: skip
    assert "linux-image-rt" in poor["kernel"]
    assert "isolcpus=managed_irq,domain,3" in poor["isolation"]
    assert "nohz_full=3 rcu_nocbs=3" in poor["timer tick"]
    assert "cpu1/online" in poor["hyper-threading"]
    assert "-c 3 frequency-set" in poor["frequency"]
    assert "irqaffinity=0,1,2" in poor["interrupts"]
    assert "/proc/irq/125/smp_affinity_list" in poor["interrupts"]
    assert "C3_ACPI (1048 us)" in found["idle states"].found


def test_where_nothing_can_be_read_nothing_is_called_good(machine):
    found = looked_at(machine({}))
    known = {name: finding.verdict for name, finding in found.items() if finding.verdict is not Verdict.UNKNOWN}
    # what is said of these is true without a file: no list names the CPU, and the kernel's version does not
    poor = dict.fromkeys(("kernel", "isolation", "timer tick"), Verdict.POOR)
    assert known == poor | {"loop's CPU": Verdict.GOOD}
    assert found["interrupts"].verdict is Verdict.UNKNOWN


@pytest.mark.parametrize(
    ("spin_us", "runtime", "verdict"),
    [(60, "950000", Verdict.GOOD), (91, "950000", Verdict.BAD), (91, "-1", Verdict.GOOD), (60, "600000", Verdict.BAD)],
)
def test_a_loop_that_spins_more_than_the_kernel_allows_is_told(machine, spin_us, runtime, verdict):
    found = looked_at(machine(TUNED | {"proc/sys/kernel/sched_rt_runtime_us": runtime}), spin_us)["throttling"]
    assert found.verdict is verdict
    assert (found.mend is not None) == (verdict is Verdict.BAD)


@pytest.mark.parametrize(
    ("cpu", "online", "allowed", "words"),
    [
        (7, "0-3", ALL, "CPU 7 is not online"),
        (3, "0-3", {0, 1}, "CPU 3 is not allowed to this process"),
        (None, "0-3", ALL, "loop.cpu is null"),
        (0, "0", {0}, "the only one"),
    ],
)
def test_a_cpu_that_is_not_there_is_told_with_those_that_are(machine, cpu, online, allowed, words):
    first = processor_findings(machine(TUNED | {"sys/devices/system/cpu/online": online}), cpu, allowed)[0]
    assert first.verdict is not Verdict.GOOD
    assert words in first.found
    assert first.mend is not None


@given(st.sets(st.integers(0, 255)))
def test_cpu_lists_are_read_in_every_way_that_they_are_written(cpus):
    ordered = sorted(cpus)
    assert cpu_list(",".join(map(str, ordered))) == cpus
    ranges, begin = [], None
    for cpu in ordered:
        begin = cpu if begin is None else begin
        if cpu + 1 not in cpus:
            ranges.append(f"{begin}-{cpu}" if cpu > begin else f"{cpu}")
            begin = None
    assert cpu_list("managed_irq,domain," + ",".join(ranges)) == cpus
