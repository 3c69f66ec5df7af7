"""The paper's experiment: a pulse on the display's own force loop, without a network.

Section 5 of the paper, Figs 17 to 20. The stepper's chapter runs other scenes the same way.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from display_node.control.force_loop import build_force_loop
from display_node.plant.stepper import StepperScene
from sensing_node.scene import build_source
from telepulse.reports.paper import published
from telepulse.scene import Scene

if TYPE_CHECKING:
    from matplotlib.figure import Figure

SETTLING_S = 2.0
BEAT_S = 0.8
Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class TrackingRun:
    """Wanted and felt force in N at times in s; the felt force at the beginning of each tick."""

    t_s: Floats
    wanted_n: Floats
    felt_n: Floats

    @property
    def force_rmse_n(self) -> float:
        """RMSE in N by eqs 23-25."""
        return float(np.sqrt(np.mean((self.felt_n - self.wanted_n) ** 2)))


def run(scene: Scene, actual: StepperScene | None = None) -> TrackingRun:
    """Run the first 6 s of a pulse after the finger has settled on the pulse's first force.

    The scene's link and playout are left out, since the paper had none.

    Parameters
    ----------
    scene
        The scene whose source, controller and actuator are run.
    actual
        The real stepper, where it differs from the one that the controller assumes.

    Raises
    ------
    SceneError, SourceError
        The loop is refused, or the source cannot be read.
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
    ticks, reach = round(published.FIRST_S / tick_s), loop.horizon + 1
    wanted_n = build_source(scene.sensing, scene.path.parent).take(ticks + reach)[:, 0]
    reference_n = wanted_n.tolist()
    for _ in range(round(SETTLING_S / tick_s)):
        loop.tick(reference_n[:1] * reach, loop.read_film())
    felt_n = []
    for tick in range(ticks):
        felt_n.append(loop.felt_n)
        loop.tick(reference_n[tick : tick + reach], loop.read_film())
    t_s = np.arange(ticks, dtype=np.float64) * tick_s
    return TrackingRun(t_s, wanted_n[:ticks], np.array(felt_n))


def draw_tracking(
    t_s: Floats, wanted: Floats, felt: Floats, quantity: str, error: str
) -> "Callable[[Figure], None]":
    """Return what draws wanted and felt values, and 1000 times their difference below."""

    def draw(figure: "Figure") -> None:
        upper, lower = figure.subplots(2, 1, sharex=True, height_ratios=(3, 2))
        upper.plot(t_s, wanted, label="wanted", linewidth=3.5, alpha=0.6)
        upper.plot(t_s, felt, label="felt", linewidth=1.2)
        upper.set_ylabel(quantity)
        figure.legend(*upper.get_legend_handles_labels(), loc="outside upper right", ncols=2)
        difference = 1e3 * (felt - wanted)
        lower.plot(t_s, difference, linewidth=1.2, color="C2")
        reach = 1.15 * np.abs(difference[t_s > BEAT_S]).max()
        lower.set(ylim=(-reach, reach), xlim=(0, published.FIRST_S))
        lower.set(xlabel="time in s", ylabel=error)
        figure.align_ylabels()

    return draw
