"""How far each contactor's felt force is behind the instant of the pulse that is played."""

import numpy as np
from numpy.typing import NDArray

from protocol.ticks import TickState
from sensing_node.scene import build_source
from telepulse.scene import Scene
from telepulse.simulation.virtual_time import (
    SENSING_CLOCK_AHEAD_NS,
    STREAM_BEGINS_NS,
    Simulation,
)

Floats = NDArray[np.float64]


def lags_ms(scene: Scene, seconds: float, settle_seconds: float) -> list[float]:
    """Simulate a scene; return by how many ms each contactor's force is late.

    A lag τ adds −τ ẋ to the force: it is the regression of the error on the pulse's slope.
    """
    simulation = Simulation(scene, seed=1)
    instants_ns: list[int] = []
    felt_n: list[list[float]] = []

    def watch(state: TickState) -> None:
        instants_ns.append(state.instant_ns)
        felt_n.append([each.felt_n for each in simulation.display.states])

    simulation.run(seconds, settle_seconds, watch)
    source = build_source(scene.sensing, scene.path.parent)
    pulse_n = source.take(round(seconds * 1e9 / source.period_ns))
    first_ns = STREAM_BEGINS_NS + SENSING_CLOCK_AHEAD_NS
    at = (np.array(instants_ns) - first_ns) / source.period_ns
    # Less than a period: the simulated clock's offset is known to some µs.
    inside = (at > 1) & (at < len(pulse_n) - 2)
    felt = np.array(felt_n)[inside]
    found = []
    for place, contactor in enumerate(simulation.display.contactors):
        channel = simulation.display.receiver.channel_numbers[place]
        force_n = contactor.force_ratio * pulse_n[:, channel]
        whole = np.arange(len(force_n))
        wanted_n: Floats = np.interp(at[inside], whole, force_n)
        slope: Floats = np.interp(at[inside], whole, np.gradient(force_n))
        slope -= slope.mean()
        late = -float((felt[:, place] - wanted_n) @ slope) / float(slope @ slope)
        found.append(late * source.period_ns * 1e-6)
    return found
