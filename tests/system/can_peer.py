"""A sensor with its amplifier on SocketCAN, made of python-can and the DBC alone: ``can_peer.py CHANNEL DATABASE LOG``.

It sends what it measures 50 times a second, and writes a line for each command: when it came (CLOCK_MONOTONIC, s), its
voltage and its count. When the bus is gone it waits for it.
"""

import itertools
import sys
import time

import can
import cantools

PERIOD_S = 0.02
UM_PER_V = 0.9
LSB_UM = 0.0001


def speak(bus, database, counts, log):
    """Serve until the bus fails."""
    sensors, voltages = database.get_message_by_name("Sensors"), database.get_message_by_name("Voltages")
    values = {signal.name: 0 for signal in sensors.signals}
    voltage_V = 0.0
    due = time.monotonic()
    while True:
        while (frame := bus.recv(max(0.0, due - time.monotonic()))) is not None:
            if frame.arbitration_id == voltages.frame_id:
                command = voltages.decode(bytes(frame.data))
                voltage_V = command["voltage_x"]
                log.write(f"{time.monotonic():.6f} {voltage_V:.5f} {command['Count']}\n")
        count = next(counts)
        values["strain_x"] = UM_PER_V * voltage_V + LSB_UM * (count % 2)  # a real one is never quite still
        values["Count"] = count % 65536
        frame_format = {"arbitration_id": sensors.frame_id, "is_extended_id": False, "is_fd": sensors.is_fd}
        bus.send(can.Message(data=sensors.encode(values), bitrate_switch=sensors.is_fd, **frame_format))
        due = max(due + PERIOD_S, time.monotonic())


def main(channel, file, log_file):
    """Come back for ever."""
    database, counts = cantools.database.load_file(file), itertools.count()
    with open(log_file, "w", buffering=1, encoding="ascii") as log:  # noqa: PTH123
        while True:
            try:
                with can.Bus(channel, "socketcan", fd=True) as bus:
                    speak(bus, database, counts, log)
            except (can.CanError, OSError):
                time.sleep(0.1)


if __name__ == "__main__":
    main(*sys.argv[1:])
