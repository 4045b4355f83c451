"""Two inverses have one identity only where every number of theirs is the same: else a swap would make a bump."""

import numpy as np
import pytest

from micromanip.rt.laws.feedforward import HYSTERESIS_PARAMETERS
from micromanip.settings.compile.hysteresis import fill_hysteresis
from micromanip.settings.schema.hysteresis import Network, PrandtlIshlinskii

PLAYS = PrandtlIshlinskii(
    model="pi",
    range_um=(0.0, 130.0),
    shaping="tanh",
    coefficients=(180.0, 0.0036, -0.11, 18.0),
    thresholds_um=(3.5, 7.0),
    weights=(0.1, 0.08),
    creep_s=(0.5,),
    creep_gains=(0.02,),
)
TABLE = PLAYS.model_copy(update={"shaping": "table", "coefficients": (), "table_V": (0.0, 9.0), "table_um": (0.0, 8.0)})
NETWORK = Network(
    model="network",
    range_um=(0.0, 130.0),
    reversal_um=1.0,
    input_weights=((0.01, 0.01, 0.01), (0.02, -0.01, 0.01)),
    input_biases=(0.1, -0.1),
    output_weights=(10.0, 20.0),
    output_bias=5.0,
)


def identity(model, period_s=1e-4):
    record = np.zeros(1, HYSTERESIS_PARAMETERS)
    fill_hysteresis(record[0], model, period_s)
    return int(record[0]["identity"])


def others(model):
    """`model` with one number of each of its keys a little larger."""
    for name in type(model).model_fields:
        value = getattr(model, name)
        if isinstance(value, float):
            yield name, model.model_copy(update={name: value + 1e-6})
        elif isinstance(value, tuple) and value:
            last = np.array(value[-1]) + 1e-6
            yield name, model.model_copy(update={name: (*value[:-1], tuple(last) if last.ndim else float(last))})


@pytest.mark.parametrize("model", [PLAYS, TABLE, NETWORK])
def test_each_key_counts(model):
    assert identity(model) == identity(model.model_copy()) != 0
    found = {name: identity(other) for name, other in others(model)}
    assert len(found) >= 6
    assert len({identity(model), *found.values()}) == len(found) + 1


def test_so_does_the_period_of_what_creeps_and_the_model_itself():
    assert identity(PLAYS) != identity(PLAYS, 2e-4)
    assert len({identity(model) for model in (PLAYS, TABLE, NETWORK)}) == 3
