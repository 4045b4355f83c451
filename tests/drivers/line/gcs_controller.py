"""A piezo controller with the General Command Set, as far as the driver uses it."""

import re

from .line_peer import LinePeer

AXES = ("x", "y", "z")
IDN = "(c)2015 Physik Instrumente (PI) GmbH & Co. KG, E-727, 0112345678, 1.2.3"

FRAMING = {
    "silence_ms": 300,
    "ascii": {
        "preset": "gcs",
        "identity": "Physik Instrumente.*E-727",
        "reply_ms": 20,
        "drain_ms": 30,
        "read": {
            "strains": {
                "command": "POS?",
                "rate_hz": 100,
                "fields": {f"strain_{axis}": {"item": str(i + 1)} for i, axis in enumerate(AXES)},
            }
        },
        "write": {
            "voltages": {
                "command": "SVA",
                "rate_hz": 100,
                "cyclic_safe": True,
                "fields": {
                    f"voltage_{axis}": {"item": str(i + 1), "range": [-20.0, 120.0]} for i, axis in enumerate(AXES)
                },
            }
        },
    },
}


class GcsController(LinePeer):
    """Answers lines in their order. `instead` replaces the next answers to POS?, in their turn."""

    framing = FRAMING
    period_s = 0.02

    def power_on(self):
        super().power_on()
        self.buffer, self.instead, self.error, self.asked = b"", [], 0, []

    def send(self, wire):
        with self.lock:
            self.instead.append(wire)

    def take(self, data):
        self.units += [data]
        *lines, self.buffer = (self.buffer + data).split(b"\n")
        for line in lines:
            if not self.silent or self.instead:
                self.heard += len(line) + 1
                self.answer(line.decode())

    def answer(self, line):
        command, *words = line.split()
        self.asked.append(command)
        if command == "*IDN?":
            self.say(IDN + "\n")
        elif command == "ERR?":
            self.say(f"{self.error}\n")
            self.error = 0
        elif command == "POS?":
            if self.instead:
                self.wire.write(self.instead.pop(0))
            else:
                values = [f"{word}={self.inputs.get('strain_' + AXES[int(word) - 1], 0.0):.4f}" for word in words]
                self.say(" \n".join(values) + "\n")
        elif command == "SVA" and all(re.fullmatch(r"-?\d+(\.\d+)?", word) for word in words):
            numbers = dict(zip(words[::2], map(float, words[1::2]), strict=True))
            self.written.append({f"voltage_{AXES[int(axis) - 1]}": value for axis, value in numbers.items()})
        else:
            self.error = 2

    def say(self, text):
        self.said += len(text)
        self.wire.write(text.encode())
