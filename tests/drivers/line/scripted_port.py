"""A port without a wire: what is sent is answered by a function of the test, each answer after a delay of its own."""

import time

from micromanip_drivers.line.port import Port

from micromanip.bus.errors import BusError


class ScriptedPort(Port):
    """`answer` gives (delay in s, bytes) for every chunk that is sent; the device answers in order."""

    def __init__(self, answer, datagrams=False):
        super().__init__("the device")
        self.answer, self.datagrams = answer, datagrams
        self.coming, self.sent = [], []
        self.counters["bytes_in"] = 0

    def open(self, deadline_ns):
        self.coming, self.sent = [], []

    def close(self):
        pass

    def send(self, data):
        self.sent.append(data)
        for delay_s, said in self.answer(data):
            after_ns = max([time.monotonic_ns(), *(due_ns for due_ns, _ in self.coming)])
            self.coming.append((after_ns + round(delay_s * 1e9), said))

    def receive(self, until_ns):
        wanted_ns = min([until_ns, *(due_ns for due_ns, _ in self.coming)])
        time.sleep(max(0.0, (wanted_ns - time.monotonic_ns()) * 1e-9))
        now_ns = time.monotonic_ns()
        there = [(said, due_ns) for due_ns, said in self.coming if due_ns <= now_ns]
        self.coming = [(due_ns, said) for due_ns, said in self.coming if due_ns > now_ns]
        self.counters["bytes_in"] += sum(len(said) for said, _ in there)
        return there

    def _connect(self, deadline_ns):
        raise NotImplementedError

    def _disconnect(self):
        raise NotImplementedError

    def _read(self, descriptor):
        raise NotImplementedError

    def _write(self, descriptor, data):
        raise NotImplementedError


def raised(call, passing=(), seconds=3.0):
    """The first bus error, but those that are `passing`, of calling it again and again; None if there was none."""
    end_s = time.monotonic() + seconds
    while time.monotonic() < end_s:
        try:
            call()
        except passing:
            time.sleep(0.001)
        except BusError as problem:
            return problem
    return None
