"""A bus driver: an amplifier for two axes that sends its strain gauges' readings by UDP."""

import math
import select
import socket
import time

from pydantic import Field

from micromanip.driver import (
    Answer,
    BusDriver,
    BusOptions,
    Channel,
    IdentityMismatch,
    Inbox,
    LinkError,
    Load,
    OutputRefused,
    Task,
    TransientError,
    Watchdog,
)

from . import wire

DATAGRAM_BITS = 84 * 8  # the shortest Ethernet frame, preamble and gap included: all of ours fit into one
ANSWER_S, TRIES = 0.15, 3
SILENCE_NS = 200_000_000
LARGEST, AT_ONCE = 2048, 200


class UdpStageOptions(BusOptions):
    """Keys of this driver in the configuration."""

    host: str = Field(default="127.0.0.1", description="Address of the amplifier.")
    port: int = Field(default=5005, ge=1, le=65535, description="Its UDP port.")
    serial_number: int = Field(description="On its type plate; another amplifier is refused.")
    command_rate_hz: float = Field(default=500.0, gt=0, le=1000, description="Voltages are sent so often.")
    link_Mbit_per_s: float = Field(default=100.0, gt=0, description="Slowest part of the network on the way.")


class UdpStage(BusDriver):
    """Strain gauges and voltages of two axes."""

    Options = UdpStageOptions

    def __init__(self, options, folder):
        self.options = options
        self.socket = None
        self.counter = None
        self.heard_ns = 0
        self.counts = {"datagrams": 0, "bad": 0, "lost": 0}

    @property
    def device(self):
        return f"udp {self.options.host}:{self.options.port}"

    @property
    def silence(self):
        return Watchdog(ms=20, rest_ms=0, after_power_on="rest")  # the amplifier's own, to 0 V

    @property
    def inputs(self):
        return [Channel(f"strain_{axis}", wire.STRAIN_RATE_HZ, latency_s=200e-6) for axis in "xy"]

    @property
    def outputs(self):
        return [Channel(f"voltage_{axis}", self.options.command_rate_hz, latency_s=200e-6) for axis in "xy"]

    @property
    def tasks(self):
        return [Task("voltages", self.options.command_rate_hz, outputs=(0, 1))]

    def loads(self):
        datagram_s = DATAGRAM_BITS / (self.options.link_Mbit_per_s * 1e6)
        rate_hz = wire.STRAIN_RATE_HZ + self.options.command_rate_hz
        return [Load("link", rate_hz * datagram_s, f"{rate_hz:g} datagrams/s x {datagram_s * 1e6:.3g} us")]

    def open(self):
        self.connect()
        serial_number = self.ask_who()
        if serial_number != self.options.serial_number:
            raise IdentityMismatch(
                f"{self.device} has serial number {serial_number}, the configuration says {self.options.serial_number}"
            )
        self.counter, self.heard_ns = None, time.monotonic_ns()

    def connect(self):
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        try:
            self.socket.connect((self.options.host, self.options.port))  # a dead port is an error from then on
            self.socket.setblocking(False)
        except OSError as problem:
            raise LinkError(f"{self.device} can't be reached: {problem}") from problem

    def ask_who(self):
        """Serial number of what answers; a datagram may get lost, so it is asked a few times."""
        for _ in range(TRIES):
            self.send(wire.sealed(wire.WHO.pack(b"?")))
            end_s = time.monotonic() + ANSWER_S
            while (left_s := end_s - time.monotonic()) > 0:
                for datagram in self.arrived(left_s):
                    if datagram[:1] == b"!" and (fields := wire.opened(datagram, wire.IAM)):
                        return fields[0]
        raise LinkError(f"{self.device} does not answer; is it switched on, is the address right?")

    def perform(self, task, values, inbox):
        steps = []
        for channel, value in zip(self.outputs, values, strict=True):
            if not math.isfinite(value) or not -32768 <= round(value / wire.V_PER_STEP) <= 32767:
                raise OutputRefused(f"{channel.name}: {value:g} V is outside -163.84..163.835 V")
            steps.append(round(value / wire.V_PER_STEP))
        self.send(wire.sealed(wire.VOLTAGES.pack(b"V", *steps)))

    def send(self, datagram):
        if self.socket is None:
            raise LinkError(f"{self.device} is not open")
        try:
            self.socket.send(datagram)
        except BlockingIOError as problem:
            raise TransientError("the transmit buffer is full") from problem
        except OSError as problem:
            raise LinkError(f"{self.device} is gone: {problem}") from problem

    def receive(self, inbox, until_ns):
        datagrams = self.arrived((until_ns - time.monotonic_ns()) * 1e-9)
        bad = sum(not self.take(datagram, inbox) for datagram in datagrams)
        now_ns = time.monotonic_ns()
        if len(datagrams) > bad:
            self.heard_ns = now_ns
        if now_ns - self.heard_ns > SILENCE_NS:
            raise LinkError(f"{self.device} has said nothing for {SILENCE_NS * 1e-9:g} s")
        if bad:
            self.counts["bad"] += bad
            raise TransientError(f"{bad} datagrams with a wrong length or checksum")

    def arrived(self, wait_s):
        """The datagrams that are there, after waiting for the first; a flood is taken in parts."""
        if self.socket is None:
            raise LinkError(f"{self.device} is not open")
        datagrams = []
        try:
            if select.select([self.socket], [], [], max(0.0, wait_s))[0]:
                while len(datagrams) < AT_ONCE:
                    datagrams += [self.socket.recv(LARGEST)]
        except BlockingIOError:
            return datagrams
        except OSError as problem:
            raise LinkError(f"{self.device} is gone: {problem}") from problem
        return datagrams

    def take(self, datagram, inbox):
        """Put what it says into `inbox`; False for one that is damaged."""
        if datagram[:1] == b"!":
            return wire.opened(datagram, wire.IAM) is not None  # an answer that came late
        fields = wire.opened(datagram, wire.STRAINS) if datagram[:1] == b"S" else None
        if fields is None:
            return False
        counter, *steps = fields
        lost = 0 if self.counter is None else (counter - self.counter - 1) % wire.COUNTS
        self.counter = counter
        self.counts["datagrams"] += 1
        self.counts["lost"] += lost
        now_ns = time.monotonic_ns()
        for channel, value in enumerate(steps):
            inbox.put(channel, value * wire.UM_PER_STEP, now_ns, lost=lost)
        return True

    def close(self):
        if self.socket is not None:
            self.socket.close()
            self.socket = None

    def statistics(self):
        return dict(self.counts)

    def probe(self, seconds):
        self.connect()
        yield Answer(self.device, {"serial_number": self.ask_who()})
        inbox, end_ns = Inbox(), time.monotonic_ns() + int(seconds * 1e9)
        self.heard_ns = time.monotonic_ns()
        while time.monotonic_ns() < end_ns:
            self.receive(inbox, end_ns)
            values = {self.inputs[sample.channel].name: sample.value for sample in inbox}
            if values:
                yield Answer("strains in um", values)
            inbox.clear()
