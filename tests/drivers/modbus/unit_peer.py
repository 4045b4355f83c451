"""A Modbus unit in a thread, on either wire, that notes what it hears and fails when it is told to."""

from types import SimpleNamespace

from micromanip.emulation.modbus.server import RtuFrames, TcpFrames, answer, sealed
from micromanip.emulation.modbus.unit import HOLDING, DeviceRegister, ModbusUnit

from ..line.line_peer import LinePeer

UNIT = 7
GAP_S, RESPONSE_S = 1.75e-3, 1e-3
IP_BITS = 8 * (14 + 20 + 20 + 4 + 8 + 12)

UNITS = {
    "cell": {
        "unit_id": UNIT,
        "address_base": 0,
        "byte_order": "big",
        "word_order": "big",
        "identity": {"serial_number": {"function": 3, "address": 9, "type": "uint16", "value": 0x1234}},
        "tasks": {
            "exchange": {
                "function": 23,
                "rate_hz": 100.0,
                "read": {
                    "strain_x": {"address": 0, "type": "int32", "scale": 0.001},
                    "strain_y": {"address": 2, "type": "float32"},
                },
                "write": {
                    "voltage_x": {"address": 100, "type": "int16", "scale": 0.005, "cyclic_safe": True},
                    "voltage_y": {"address": 101, "type": "int16", "scale": 0.005, "cyclic_safe": True},
                },
            }
        },
    }
}


def units(**changed):
    """The units of above, with keys of the one unit changed."""
    return {"cell": {**UNITS["cell"], **changed}}


def register(address, kind, byte_order="big", word_order="big", **keys):
    """A register of a simulated device, by keys of the driver."""
    unit = SimpleNamespace(address_base=0, byte_order=byte_order, word_order=word_order)
    return DeviceRegister("", unit, SimpleNamespace(address=address, type=kind, **keys))


class Raw(bytes):
    """What is sent as it is, without a header."""


class Behind:
    """What a ModbusUnit measures and moves."""

    def __init__(self, peer):
        self.peer = peer

    def advance_to(self, now_ns):
        pass

    def read(self, channel):
        return self.peer.inputs.get(channel, 0.0)

    def write(self, values):
        self.peer.written.append(values)


class UnitPeer(LinePeer):
    """Answers, or says in place of the next answers what it was told to."""

    word_order = "big"

    def __init__(self, wire):
        super().__init__(wire)
        self.framing = {"timeout_ms": 50.0, "response_ms": 1e3 * RESPONSE_S, "units": UNITS}

    def power_on(self):
        super().power_on()
        self.transactions, self.to_say = [], []
        self.hearing = self.new_frames()
        self.unit = unit = ModbusUnit("cell", Behind(self))
        order = {"word_order": self.word_order}
        unit.add_measured(HOLDING, register(0, "int32", scale=0.001, **order), "cell.strain_x")
        unit.add_measured(HOLDING, register(2, "float32", **order), "cell.strain_y")
        unit.add_output(HOLDING, register(100, "int16", scale=0.005), "cell.voltage_x")
        unit.add_output(HOLDING, register(101, "int16", scale=0.005), "cell.voltage_y")
        unit.add_constant(HOLDING, register(9, "uint16"), 0x1234)

    def new_frames(self):
        return TcpFrames()

    def take(self, data):
        if self.silent and not self.to_say:
            self.hearing = self.new_frames()
            return
        for request in self.hearing.taken(data, 0):
            self.units.append(self.whole(bytes((request.unit,)) + request.pdu))
            said = self.answer(request)
            self.transactions.append((len(request.pdu), len(said)))
            self.wire.write(said)

    def answer(self, request):
        if not self.to_say:
            return request.seal(answer(self.unit, request.pdu, 0))
        wire = self.to_say.pop(0)
        return wire if isinstance(wire, Raw) else self.in_place(request, wire)

    def in_place(self, request, wire):
        """Unit and PDU of its own choice, under the number of the request."""
        return request.seal(wire[1:])[:6] + wire

    def whole(self, frame):
        """A unit as ``received`` gives it: number of the unit, and PDU."""
        return frame

    def send(self, wire):
        with self.lock:
            self.to_say.append(wire)

    def busy_s(self):
        with self.lock:
            seen, self.transactions = self.transactions, []
        bits = sum(8 * (asked + said + 7) + 2 * IP_BITS for asked, said in seen)
        return {f"tcp 127.0.0.1:{self.wire.port}": len(seen) * RESPONSE_S + bits / 100e6}


class RtuPeer(UnitPeer):
    """On a pseudo terminal, with the low word first."""

    word_order = "little"

    def __init__(self, wire):
        super().__init__(wire)
        self.framing = {**self.framing, "units": units(word_order="little")}

    def new_frames(self):
        return RtuFrames(5_000_000)

    def in_place(self, request, wire):
        return wire

    def whole(self, frame):
        return sealed(frame)

    def busy_s(self):
        with self.lock:
            seen, self.transactions = self.transactions, []
        characters = sum(asked + 3 + said for asked, said in seen)
        return {str(self.wire.path): len(seen) * (RESPONSE_S + 2 * GAP_S) + characters * 10 / 1_000_000}
