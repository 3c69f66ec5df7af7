import math

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.signal import lsim

from display_node.plant.scene import SecondOrderScene
from display_node.plant.second_order import SecondOrder

TABLE_4 = (0.65, 0.61, 4.23)
# Rotors that resonate at 100 Hz with these dampings, on which the methods of textbooks grow.
OMEGA = 2 * math.pi * 100
ROTORS = [(1.0, 2 * damping * OMEGA, OMEGA**2) for damping in (0.001, 0.2, 0.99)]


def forces_n(
    volts: NDArray[np.float64], tick_s: float, m: float, c: float, k: float
) -> NDArray[np.float64]:
    scene = SecondOrderScene.model_validate({"kind": "second_order", "m": m, "c": c, "k": k})
    model = SecondOrder(scene, tick_s)
    forces = [model.force_n]
    for held in volts.tolist():
        forces.append(model.step(held))
        assert model.force_n == forces[-1]
    return np.array(forces)


def test_the_defaults_are_the_papers_table_4() -> None:
    scene = SecondOrderScene.model_validate({"kind": "second_order"})
    assert (scene.m, scene.c, scene.k) == TABLE_4


@pytest.mark.parametrize("tick_s", [1e-6, 1e-3, 0.1])
@pytest.mark.parametrize(
    "mck", [TABLE_4, (1.0, 0.0, 4.0), (0.65, 0.61, 0.0), (0.01, 5.0, 4.23), *ROTORS]
)
def test_held_voltages_agree_with_lsim(tick_s: float, mck: tuple[float, float, float]) -> None:
    m, c, k = mck
    volts = np.random.default_rng(2).normal(0, 10, 500)
    t_s = np.arange(501) * tick_s
    held = np.append(volts, volts[-1])
    # State space: lsim of a transfer function warns of k = 0.
    system = ([[0, 1], [-k / m, -c / m]], [[0], [1 / m]], [[1, 0]], [[0]])
    _, expected, _ = lsim(system, held, t_s, interp=False)
    forces = forces_n(volts, tick_s, *mck)
    assert np.abs(forces - expected).max() <= 1e-9 * np.abs(expected).max()
