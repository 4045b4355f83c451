"""What is said of the network card of an EtherCAT line, on machines that are not this one."""

import pytest

from micromanip.host.readiness.finding import Verdict
from micromanip.host.readiness.network import network_findings

from .machines import TUNED

CARD = TUNED | {
    "sys/class/net/eno1/ifindex": "2\n",
    "sys/class/net/eno1/device/uevent": "DRIVER=e1000e\nPCI_CLASS=20000\n",
    "sys/class/net/eno1/device/modalias": "pci:v00008086d000015FBsv0000\n",
    "proc/irq/125/smp_affinity_list": "0-2\n",
}
QUIET = "Coalesce parameters for eno1:\nAdaptive RX: off  TX: off\nrx-usecs: 0\nrx-frames: n/a\ntx-usecs: 0\n"


def thread(number, name, rt_priority):
    """Files of a thread in /proc."""
    fields = ["S", *["0"] * 36, str(rt_priority), "1", *["0"] * 11]
    return {f"proc/{number}/comm": name + "\n", f"proc/{number}/stat": f"{number} ({name}) {' '.join(fields)}\n"}


def found(machine, said=QUIET, interface="eno1"):
    of_all = network_findings(machine, [interface], 3, 80, lambda _: said)
    return {finding.name.partition(": ")[2]: finding for finding in of_all}


def test_a_card_that_is_set_up_is_good(machine):
    of_card = found(machine(CARD | thread(77, "irq/125-eno1", 50)))
    assert {name: finding.verdict for name, finding in of_card.items()} == dict.fromkeys(
        ("driver", "coalescing", "interrupts"), Verdict.GOOD
    )
    assert of_card["driver"].found == "e1000e"
    assert of_card["interrupts"].found == "IRQ 125 on CPU 0, 1, 2, threads at FIFO 50"


@pytest.mark.parametrize(
    ("rt_priority", "verdict"), [(50, Verdict.POOR), (80, Verdict.POOR), (85, Verdict.GOOD), (None, Verdict.POOR)]
)
def test_interrupts_on_the_loops_cpu_need_to_go_before_the_loop(machine, rt_priority, verdict):
    files = CARD | {"proc/irq/125/smp_affinity_list": "3\n"}
    files |= {} if rt_priority is None else thread(77, "irq/125-eno1", rt_priority)
    files |= thread(78, "irq/126-other", 1)
    interrupts = found(machine(files))["interrupts"]
    assert interrupts.verdict is verdict
    if verdict is Verdict.POOR:
        assert "echo 0,1,2 | sudo tee /proc/irq/125/smp_affinity_list" in interrupts.mend
        assert ("chrt -f -p 85 77" in interrupts.mend) is (rt_priority is not None)
