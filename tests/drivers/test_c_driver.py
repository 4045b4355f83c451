"""A cyclic driver from a C library: compiled here, called by the loop's own code, values arrive."""

import ctypes
import shutil
import subprocess
from dataclasses import replace
from typing import ClassVar

import numpy as np
import pytest
from pydantic import BaseModel, ConfigDict

from micromanip.bus.cyclic import CyclicDriver, Functions, call_context
from micromanip.rt.states import ARM, DRIVER_ERROR, FAULT, READY, TRACKING
from micromanip.settings.compile.cell import compile_cell
from micromanip.settings.schema.faults import AxisFaults, StrainInvalid
from micromanip.settings.schema.reference import Hold
from micromanip.virtual.cell import VirtualCell

from .simulated_bench import tuned_cell

SOURCE = r"""
#include <stdint.h>

struct signal { double value; int64_t time_ns; int64_t sequence; int64_t status; };
struct card { int64_t opened, exchanges, periods, fail_at; double voltage[3], position[3]; };

int32_t card_open(void *context) { ((struct card *)context)->opened = 1; return 0; }
int32_t card_close(void *context) { ((struct card *)context)->opened = 0; return 0; }

int32_t card_safe(void *context)
{
    for (int i = 0; i < 3; i++) ((struct card *)context)->voltage[i] = 0.0;
    return 0;
}

int32_t card_exchange(void *context, const double *outputs, struct signal *inputs, int64_t now_ns, int64_t periods)
{
    struct card *card = context;
    if (!card->opened) return 11;
    card->exchanges++;
    card->periods += periods;
    if (card->exchanges == card->fail_at) return 12;
    for (int i = 0; i < 3; i++) {
        card->position[i] += 0.3 * (0.9 * card->voltage[i] - card->position[i]);
        inputs[i].value = card->position[i];
        inputs[i].time_ns = now_ns;
        inputs[i].sequence++;
        inputs[i].status = 0;
        card->voltage[i] = outputs[i];
    }
    return 0;
}
"""
CARD = np.dtype(
    [(name, "i8") for name in ("opened", "exchanges", "periods", "fail_at")]
    + [("voltage", "f8", 3), ("position", "f8", 3)]
)


class CardOptions(BaseModel):
    model_config = ConfigDict(extra="forbid")
    fail_at: int = 0


@pytest.fixture(scope="module")
def card_driver(tmp_path_factory):
    """The driver's class, its library freshly compiled."""
    compiler = shutil.which("gcc") or shutil.which("cc")
    if compiler is None:
        pytest.skip("no C compiler on this machine")
    folder = tmp_path_factory.mktemp("card")
    (folder / "card.c").write_text(SOURCE)
    command = [compiler, "-Wall", "-Werror", "-O2", "-shared", "-fPIC", "-o", folder / "card.so", folder / "card.c"]
    subprocess.run(command, check=True, timeout=60)
    library = ctypes.CDLL(str(folder / "card.so"))

    class Card(CyclicDriver):
        Options: ClassVar = CardOptions
        inputs = ("strain_x", "strain_y", "strain_z")
        outputs = ("voltage_x", "voltage_y", "voltage_z")

        def __init__(self, options, period_ns):
            self.options = options

        def context(self):
            card = np.zeros(1, CARD)
            card["fail_at"] = self.options.fail_at
            return card.view(np.uint8)

        def functions(self):
            names = ("card_open", "card_exchange", "card_safe", "card_close")
            return Functions(*(ctypes.cast(getattr(library, name), ctypes.c_void_p).value for name in names))

    return Card


def cell(card_driver, **options):
    """Three axes in mode strain on the card, and the card's context."""
    given = tuned_cell()
    faults = AxisFaults(strain=StrainInvalid(identical=None))  # the card has no noise
    changed = {"mode": "strain", "faults": faults}
    axes = {name: axis.model_copy(update=changed) for name, axis in given.configuration.axes.items()}
    configuration = given.configuration.model_copy(
        update={"axes": axes, "reference": Hold(source="hold", offset_um=60.0)}
    )
    wiring = replace(
        given.wiring,
        drivers={"cell": card_driver(CardOptions(**options), 100_000)},
        signals={f"strain_{name}": i for i, name in enumerate("xyz")},
        outputs={f"voltage_{name}": i for i, name in enumerate("xyz")},
    )
    virtual = VirtualCell(compile_cell(configuration, wiring), wiring)
    return virtual, virtual._contexts[0].view(CARD)[0]


def test_values_arrive_both_ways(card_driver):
    virtual, card = cell(card_driver)
    assert card["opened"] == 1
    rows = virtual.arm()
    assert virtual.state[0]["state"] == TRACKING
    assert card["exchanges"] == card["periods"] == virtual.state[0]["cycle"]
    rows = virtual.run(0.1)
    assert rows["axis"]["strain_um"][-1] == pytest.approx(60.0, abs=1e-3)
    # what the card latched is what the loop decided last; what the loop read is what the card left
    assert card["voltage"] == pytest.approx(rows["axis"]["voltage_V"][-2])
    assert rows["axis"]["strain_um"][-1].tolist() == card["position"].tolist()
    assert card["voltage"].min() > 40.0


def test_a_code_of_its_own_ends_in_a_fault(card_driver):
    virtual, card = cell(card_driver, fail_at=250)
    virtual.run(0.01)
    virtual.run(0.0149, command=ARM)
    assert (card["exchanges"], virtual.state[0]["fault"]) == (249, 0)
    virtual.run(1e-4)
    s = virtual.state[0]
    assert (s["fault"], s["fault_axis"], s["fault_value"]) == (DRIVER_ERROR, -1, 12.0)
    virtual.run(0.6)
    assert virtual.state[0]["state"] == FAULT
    assert card["exchanges"] > 6000  # the ramp went on reaching the card
    assert card["voltage"].tolist() == [0.0, 0.0, 0.0]


def test_safe_and_close(card_driver):
    virtual, card = cell(card_driver)
    virtual.arm()
    functions = card_driver(CardOptions(), 100_000).functions()
    assert card["voltage"].min() > 1.0
    assert call_context(functions.safe, virtual._contexts[0].ctypes.data) == 0
    assert card["voltage"].tolist() == [0.0, 0.0, 0.0]
    assert call_context(functions.close, virtual._contexts[0].ctypes.data) == 0
    assert virtual.state[0]["state"] != READY
    virtual.run(1e-4)
    assert virtual.state[0]["fault_value"] == 11.0
