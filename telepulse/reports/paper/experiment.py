"""A pulse on the display's own force loop, as a scene describes it; nothing between them."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from display_node.control.force_loop import build_force_loop
from display_node.plant.stepper import StepperScene
from sensing_node.scene import build_source
from telepulse.reports.paper import numbers
from telepulse.scene import Scene

SETTLING_S = 2.0


@dataclass(frozen=True, slots=True)
class ExperimentRun:
    """Wanted and felt force in N at times in s; the felt one as each tick begins."""

    t_s: NDArray[np.float64]
    wanted_n: NDArray[np.float64]
    felt_n: NDArray[np.float64]

    @property
    def force_rmse_n(self) -> float:
        """Eqs 23-25, in N."""
        return float(np.sqrt(np.mean((self.felt_n - self.wanted_n) ** 2)))


def run(scene: Scene, actual: StepperScene | None = None) -> ExperimentRun:
    """The first 6 s of pulse, after the finger has settled on the pulse's first force.

    The scene's link and playout are left out: the paper had none. actual: what the stepper
    really is, where the controller is wrong about it. Raises SceneError or SourceError.
    """
    display, tick_s = scene.display, scene.display.tick_ns * 1e-9
    loop = build_force_loop(
        display.controller,
        display.actuator,
        display.layer.layer(),
        display.film,
        display.safety.force_limit_n,
        tick_s,
        actual,
    )
    ticks, reach = round(numbers.FIRST_S / tick_s), loop.horizon + 1
    wanted_n = build_source(scene.sensing, scene.path.parent).take(ticks + reach)[:, 0]
    reference_n = wanted_n.tolist()
    for _ in range(round(SETTLING_S / tick_s)):
        loop.tick(reference_n[:1] * reach, loop.read_film())
    felt_n = []
    for tick in range(ticks):
        felt_n.append(loop.felt_n)
        loop.tick(reference_n[tick : tick + reach], loop.read_film())
    return ExperimentRun(
        np.arange(ticks, dtype=np.float64) * tick_s, wanted_n[:ticks], np.array(felt_n)
    )
