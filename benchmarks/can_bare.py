"""Bare python-can at the rates of config/can.yaml: ``python -m benchmarks.can_bare CHANNEL SECONDS``.

Receives all there is, sends the voltages' frame at its rate, and does nothing else with either. Prints its use of a
CPU, 1 is all of one.
"""

from __future__ import annotations

import sys
import time

import can

from .can_flood import BITRATE, DATA_BITRATE

VOLTAGES, LENGTH, RATE_HZ = 0x100, 8, 2000.0


def main() -> None:
    """Take part for so long."""
    channel, seconds = sys.argv[1], float(sys.argv[2])
    message = can.Message(
        arbitration_id=VOLTAGES, data=bytes(LENGTH), is_extended_id=False, is_fd=True, bitrate_switch=True
    )
    with can.Bus(channel, "micromanip", ignore_config=True, fd=True, bitrate=BITRATE, data_bitrate=DATA_BITRATE) as bus:
        begin, used = time.monotonic(), time.process_time()
        due = begin
        while (now := time.monotonic()) < begin + seconds:
            if now >= due:
                due += 1.0 / RATE_HZ
                try:
                    bus.send(message, timeout=0)
                except can.CanOperationError:
                    continue  # the queue is full
            bus.recv(max(0.0, due - now))
        print((time.process_time() - used) / (time.monotonic() - begin))  # noqa: T201


if __name__ == "__main__":
    main()
