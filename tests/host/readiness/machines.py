"""Folders as the kernel shows them on machines that are not this one."""

import pytest

from micromanip.host.readiness.finding import Machine

TUNED = {
    "sys/kernel/realtime": "1\n",
    "sys/devices/system/clocksource/clocksource0/current_clocksource": "tsc\n",
    "proc/sys/kernel/sched_rt_runtime_us": "950000\n",
    "proc/sys/kernel/sched_rt_period_us": "1000000\n",
    "proc/cpuinfo": "processor\t: 0\nmodel name\t: Intel(R) Core(TM) i7-1185GRE\nflags\t\t: fpu vme nonstop_tsc\n",
    "sys/kernel/mm/transparent_hugepage/enabled": "always [madvise] never\n",
    "sys/devices/system/cpu/online": "0-3\n",
    "sys/devices/system/cpu/isolated": "3\n",
    "sys/devices/system/cpu/nohz_full": "3\n",
    "sys/devices/system/cpu/cpu3/topology/thread_siblings_list": "3\n",
    "sys/devices/system/cpu/cpu3/cpufreq/scaling_governor": "performance\n",
    "sys/devices/system/cpu/cpu3/cpuidle/state0/name": "POLL\n",
    "sys/devices/system/cpu/cpu3/cpuidle/state0/latency": "0\n",
    "sys/devices/system/cpu/cpu3/cpuidle/state1/name": "C1_ACPI\n",
    "sys/devices/system/cpu/cpu3/cpuidle/state1/latency": "1\n",
    "sys/devices/system/cpu/cpu3/cpuidle/state2/name": "C3_ACPI\n",
    "sys/devices/system/cpu/cpu3/cpuidle/state2/latency": "1048\n",
    "sys/devices/system/cpu/cpu3/cpuidle/state2/disable": "1\n",
    "proc/cmdline": "BOOT_IMAGE=/vmlinuz ro quiet isolcpus=managed_irq,domain,3 nohz_full=3 irqaffinity=0-2\n",
    "proc/interrupts": (
        "           CPU0       CPU1       CPU2       CPU3       \n"
        "   8:          0          0          0          0  IR-IO-APIC    8-edge      rtc0\n"
        " 125:     123456          0          7          0  IR-PCI-MSIX-0000:00:1f.6    0-edge      eno1\n"
        " NMI:          1          1          1          1   Non-maskable interrupts\n"
        " LOC:    9000000    8000000    7000000     600000   Local timer interrupts\n"
        " ERR:          0\n"
    ),
}
"""An industrial computer of four cores, set up as docs/your-cell.md says."""

DESKTOP = TUNED | {
    "sys/kernel/realtime": "",
    "sys/devices/system/clocksource/clocksource0/current_clocksource": "hpet\n",
    "sys/kernel/mm/transparent_hugepage/enabled": "[always] madvise never\n",
    "sys/devices/system/cpu/isolated": "\n",
    "sys/devices/system/cpu/nohz_full": "(null)\n",
    "sys/devices/system/cpu/cpu3/topology/thread_siblings_list": "1,3\n",
    "sys/devices/system/cpu/cpu3/cpufreq/scaling_governor": "powersave\n",
    "sys/devices/system/cpu/cpu3/cpuidle/state2/disable": "0\n",
    "proc/cmdline": "BOOT_IMAGE=/vmlinuz ro quiet splash\n",
    "proc/cpuinfo": TUNED["proc/cpuinfo"].replace("nonstop_tsc", "hypervisor nonstop_tsc"),
    "proc/interrupts": TUNED["proc/interrupts"].replace("7          0  IR-PCI", "7     990021  IR-PCI"),
    "proc/irq/125/effective_affinity_list": "3\n",
}
"""The same computer as it comes out of the box, as a guest."""


@pytest.fixture
def machine(tmp_path):
    """Makes a machine of a dictionary of files."""

    def make(files):
        for place, text in files.items():
            file = tmp_path / place
            file.parent.mkdir(parents=True, exist_ok=True)
            file.write_text(text)
        return Machine(tmp_path)

    return make
