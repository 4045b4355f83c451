"""The linear plant that the simulation tells of: at rest it is springs, and creep adds up to the same displacement."""

import numpy as np
import pytest
from micromanip_drivers.simulated.driver import SimulatedCell
from micromanip_drivers.simulated.linear import linear_plant
from micromanip_drivers.simulated.options import Options, Plant


@pytest.mark.parametrize("options", [{}, {"piezo_N_per_um": 300.0, "second_mode": {}}])
def test_at_rest_the_plant_is_its_springs(options):
    plant = Plant.model_validate(options)
    found = linear_plant(plant, 1e-4, creep=False)
    kp, kf, kg, n = plant.piezo_N_per_um, plant.flexure_N_per_um, plant.guide_N_per_um, plant.lever
    stiffness = np.array([[kp + n * n * kf, -n * kf], [-n * kf, kf + kg]])
    for driven, force in ((found.voltage, [kp, 0.0]), (found.force, [0.0, 1.0])):
        rest = np.linalg.solve(np.eye(len(found.A)) - found.A, driven)
        actuator, stage = np.linalg.solve(stiffness, force)
        assert found.strain @ rest == pytest.approx(actuator, rel=1e-6)
        assert found.stage @ rest == pytest.approx(stage, rel=1e-6)


def test_creep_delays_a_displacement_and_leaves_its_size():
    plain, crept = (linear_plant(Plant(), 1e-4, creep=creep) for creep in (False, True))
    steady = [p.stage @ np.linalg.solve(np.eye(len(p.A)) - p.A, p.voltage) for p in (plain, crept)]
    assert steady[1] == pytest.approx(steady[0], rel=1e-6)
    x, after = [np.zeros(len(p.A)) for p in (plain, crept)], []
    for p, state in zip((plain, crept), x, strict=True):
        for _ in range(3000):
            state[:] = p.A @ state + p.voltage
        after.append(p.stage @ state)
    # after 0.3 s the operators from 0.3 s to 1000 s, half of 13 with 0.5 % each, have hardly begun
    assert after[1] == pytest.approx((1 - 7.5 * 0.005) * after[0], rel=0.01)


def test_each_axis_is_told_with_its_own_plant_and_what_its_neighbours_move():
    options = Options.model_validate({"variation": {"y": {"stage_kg": 13.0}}, "coupling": 0.03})
    cell = SimulatedCell(options, 100_000)
    x, y = cell.simulated_axis("x"), cell.simulated_axis("y")
    assert not np.allclose(x.plant.A, y.plant.A)
    assert [hertz for hertz, _ in y.deviation][-1] == pytest.approx(0.97 * 8.0)
    assert max(um for _, um in x.neighbours) == pytest.approx(0.03 * 130.0)
    assert len(x.neighbours) == 8
