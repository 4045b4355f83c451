"""A gauge (node 5) and an amplifier (node 6) on CANopen, by the library's own nodes; readings of the gauge go wrong."""

import struct
import time

import canopen
from canopen.sdo import SdoAbortedError

from micromanip.testbus.frame import Frame

from ..fault_cells import CONFIG
from .amplifier import OUTPUTS
from .can_node import CanBus

GAUGE, AMPLIFIER = 5, 6
_EDS = {GAUGE: CONFIG / "can" / "sensor.eds", AMPLIFIER: CONFIG / "can" / "amplifier.eds"}
_SYNC, _EMERGENCY, _READINGS, _STRANGER, _VOLTAGES, _HEARTBEAT = 0x80, 0x80, (0x180, 0x280), 0x480, 0x200, 0x700
_HEARTBEAT_TIME, _OUTPUT, _STRUCTURE = 0x1017, 0x6411, 0x060A0023
_V, _UM, _BAD = 0.005, 1e-4, -(2**31)
_SENSOR_ERROR, _DEVICE_ERROR = 0x5000, 0x81


class CanOpenNodes(CanBus):
    """They boot with the amplifier's power; PDOs as their EDS files describe them."""

    def boot(self):
        """Both send their boot-up message."""
        network = self._network = canopen.Network(self._Wire(self))
        self._nodes = [network.create_node(number, str(eds)) for number, eds in _EDS.items()]
        self._beats_s, self._told = dict.fromkeys(self._nodes, 0.0), False
        for node in self._nodes:
            node.nmt.start_heartbeat = lambda ms: None  # `say` does it: a thread of the library's would not be cut
            node.nmt.send_command(0)
            node.nmt.send_command(128)
        self._nodes[1].add_read_callback(self._register)

    class _Wire:
        def __init__(self, bus):
            self.send = lambda message: bus.send(Frame(message.arbitration_id, bytes(message.data)))

    def hear(self, frame):
        """NMT and SDO are the library's."""
        gauge, amplifier = self._nodes
        self._network.notify(frame.identifier, bytearray(frame.data), time.monotonic())
        if frame.identifier == _SYNC and gauge.nmt.state == "OPERATIONAL":
            self._measure()
        elif frame.identifier == _VOLTAGES + AMPLIFIER and amplifier.nmt.state == "OPERATIONAL":
            counts = struct.unpack_from("<hh", frame.data)
            self.amplifier.command({name: _V * count for name, count in zip(OUTPUTS, counts, strict=True)})

    def _measure(self):
        fails = self.amplifier.fails
        for first, um in zip(_READINGS, self.amplifier.strains_um(), strict=True):
            code = _BAD if fails in ("nan", "garbage") else round(um / _UM)
            data = b"" if fails == "empty" else struct.pack("<ii", code, 0)
            if fails not in ("silent", "exception"):
                self.send_reading(Frame((_STRANGER if fails == "wrong unit" else first) + GAUGE, data))

    def say(self):
        """Heartbeats, and an emergency that begins or ends."""
        errs = self.amplifier.fails == "exception"
        if errs != self._told:
            self._told = errs
            register = _DEVICE_ERROR if errs else 0
            self._nodes[0].set_data(0x1001, 0, bytes((register,)))
            self._nodes[0].emcy.send(_SENSOR_ERROR if errs else 0, register)
        for node in self._nodes:
            period_s = 1e-3 * int.from_bytes(node.get_data(_HEARTBEAT_TIME, 0), "little")
            if period_s and time.monotonic() - self._beats_s[node] >= period_s:
                self._beats_s[node] = time.monotonic()
                self.send(Frame(_HEARTBEAT + node.id, bytes((node.nmt._state,))))

    def _register(self, index, subindex, od):
        """What an output object reads; its subindices begin at 1."""
        if index != _OUTPUT or not 1 <= subindex <= len(OUTPUTS):
            return None
        if (values := self.amplifier.registers()) is None:
            raise SdoAbortedError(_STRUCTURE)
        return round(values[OUTPUTS[subindex - 1]] / _V)
