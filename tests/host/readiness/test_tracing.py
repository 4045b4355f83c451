"""What made a cycle late, read out of traces as the kernel writes them."""

import pytest

from micromanip.host.readiness.tracing import UNSEEN, explained, parsed, traced, why_not

LOOP = 500
TRACE = """\
# tracer: nop
#
#           TASK-PID     CPU#  |||||  TIMESTAMP  FUNCTION
#              | |         |   |||||     |         |
          <idle>-0       [001] d..2.    99.999000: sched_switch: prev_comm=python prev_pid=500 prev_prio=19 prev_state=S ==> next_comm=swapper/1 next_pid=0 next_prio=120
          <idle>-0       [001] d..2.    99.999500: sched_switch: prev_comm=swapper/1 prev_pid=0 prev_prio=120 prev_state=R ==> next_comm=a (b) c next_pid=77 next_prio=120
      a (b) c-77       [001] d.h..    99.999950: irq_handler_entry: irq=36 name=virtio1-req.0
      a (b) c-77       [001] d.h2.    99.999955: softirq_raise: vec=4 [action=BLOCK]
      a (b) c-77       [001] d.h..   100.000010: irq_handler_exit: irq=36 ret=handled
      a (b) c-77       [001] ..s..   100.000020: softirq_entry: vec=4 [action=BLOCK]
      a (b) c-77       [001] d.h..   100.000030: local_timer_entry: vector=236
      a (b) c-77       [001] dNh..   100.000035: local_timer_exit: vector=236
      a (b) c-77       [001] ..s..   100.000050: softirq_exit: vec=4 [action=BLOCK]
      a (b) c-77       [001] d..2.   100.000060: sched_switch: prev_comm=a (b) c prev_pid=77 prev_prio=120 prev_state=R ==> next_comm=python next_pid=500 next_prio=19
"""  # noqa: E501


def late(lateness_us, due_us=100_000_000, spin_us=60, trace=TRACE):
    found = explained(parsed(trace.splitlines()), LOOP, due_us * 1000, lateness_us * 1000, spin_us * 1000)
    return dict(found.causes)


def test_every_microsecond_is_laid_at_one_door():
    causes = late(70)
    assert causes == {
        "interrupt virtio1-req.0": 60,  # 50 of them before the cycle was due, after the loop was to be woken
        "a (b) c [77]": 10 + 10 + 10,
        "softirq BLOCK": 10 + 15,
        "interrupt local_timer": 5,
        UNSEEN: 10,
    }
    assert sum(causes.values()) == 60 + 70


@pytest.mark.skipif(why_not() is not None, reason="needs tracefs, and the right to use it")
def test_the_kernel_s_own_trace_is_read_and_taken_back():
    import os
    import time

    from micromanip.host.readiness.tracing import _FOLDER

    cpu = min(os.sched_getaffinity(0))
    with traced(cpu) as trace:
        for _ in range(20):
            time.sleep(0.002)
        events = trace.events(cpu)
    assert {event.name for event in events} >= {"sched_switch"}
    moments = [event.us for event in events]
    assert moments == sorted(moments)
    assert abs(moments[-1] * 1e-6 - time.monotonic()) < 60
    assert not list((_FOLDER / "instances").glob(f"*{os.getpid()}"))
