"""Register maps of any kind: planned into transactions, asked of a simulated unit, and read back as they are."""

from hypothesis import given
from hypothesis import strategies as st
from micromanip_drivers.modbus.options import REGISTERS, ModbusOptions
from micromanip_drivers.modbus.plan import plan_tasks

from micromanip.emulation.modbus.server import answer
from micromanip.emulation.modbus.unit import HOLDING, ModbusUnit

from .unit_peer import register

WORDS = [kind for kind in REGISTERS if kind not in ("coil", "bits")]
KEYS = {"tcp": {"host": "h", "port": 502}, "timeout_ms": 20, "response_ms": 1}


def plans(tasks, **unit):
    whole = {"unit_id": 1, "address_base": 0, "byte_order": "big", "word_order": "big", "tasks": tasks, **unit}
    return plan_tasks(ModbusOptions.model_validate({**KEYS, "units": {"u": whole}}))


@st.composite
def register_maps(draw, most=30):
    """Registers that don't overlap, with gaps between some of them: name to (address, type)."""
    found, address = {}, draw(st.integers(0, 1000))
    for i in range(draw(st.integers(1, most))):
        address += draw(st.sampled_from([0, 0, 0, 1, 7]))
        kind = draw(st.sampled_from(WORDS))
        found[f"r{i}"] = (address, kind)
        address += REGISTERS[kind]
    return found


class Memory:
    """What a unit measures is given; what is written to it is kept."""

    def __init__(self, values):
        self.values = values

    def advance_to(self, now_ns):
        pass

    def read(self, channel):
        return self.values[channel]

    def write(self, values):
        self.values.update(values)


@given(register_maps(), st.data())
def test_what_is_read_is_what_the_unit_has(found, data):
    base = data.draw(st.sampled_from([0, 1, 40001]))
    byte_order, word_order = (data.draw(st.sampled_from(["big", "little"])) for _ in range(2))
    order = {"byte_order": byte_order, "word_order": word_order}
    read = {name: {"address": address + base, "type": kind} for name, (address, kind) in found.items()}
    shuffled = dict(data.draw(st.permutations(list(read.items()))))
    (plan,) = plans({"t": {"function": 3, "rate_hz": 1, "read": shuffled}}, address_base=base, **order)
    values = {f"u.{name}": float(data.draw(st.integers(0, 30_000))) for name in found}
    unit = ModbusUnit("u", Memory(values))
    for name, (address, kind) in found.items():
        unit.add_measured(HOLDING, register(address, kind, **order), f"u.{name}")
    got = {}
    for exchange in plan.exchanges:
        said = answer(unit, exchange.request({}), 0)
        assert len(said) == exchange.answer_bytes
        assert said.startswith(exchange.answer_head(b""))
        got |= dict(zip(exchange.inputs, exchange.values(said), strict=True))
    assert got == values


@given(register_maps(most=12), st.data())
def test_what_is_written_is_what_the_unit_gets(found, data):
    write = {n: {"address": address, "type": kind, "cyclic_safe": True} for n, (address, kind) in found.items()}
    (plan,) = plans({"t": {"function": 16, "rate_hz": 1, "write": write}})
    wanted = {f"u.{name}": float(data.draw(st.integers(0, 30_000))) for name in found}
    memory = Memory({})
    unit = ModbusUnit("u", memory)
    for name, (address, kind) in found.items():
        unit.add_output(HOLDING, register(address, kind), f"u.{name}")
    for exchange in plan.exchanges:
        request = exchange.request(wanted)
        assert answer(unit, request, 0) == request[:5]
    assert memory.values == wanted
