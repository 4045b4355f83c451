"""What an emulated device sends over and over, on a machine that stands still and is hardly fast enough afterwards."""

from micromanip.emulation.messages import Due, MessageFigures, Periodic

PERIOD_NS = 1_000_000


class BusyLoop:
    """An event loop whose clock goes on by what its calls cost: 1 % less than there is."""

    time_ns = 0

    def now_ns(self):
        return self.time_ns

    def call_at(self, time_ns, callback):
        self.timer = time_ns, callback

    def run(self, calls):
        for _ in range(calls):
            time_ns, callback = self.timer
            self.time_ns = max(self.time_ns, time_ns)
            callback()
            self.time_ns += 0.99 * PERIOD_NS


def test_after_a_stall_samples_are_young_again():
    """Old ones are lost until the device is at the present; losing just enough, it would stay behind for ever."""
    loop, figures, sent = BusyLoop(), MessageFigures(), []

    def send(due):
        sent.append((due.counted(), loop.time_ns - due.due_ns))

    Periodic(loop, figures, Due("Sensors", PERIOD_NS), lambda _: None, send).start(0)
    loop.run(10)
    loop.time_ns += 6 * PERIOD_NS
    loop.run(1000)
    assert max(age for _, age in sent[11:]) <= PERIOD_NS
    assert sent[-1][0] == len(sent) + figures.not_sent - 1 > len(sent), "the counter shows what was lost"
