"""An emulated wrist under the probe of an emulated drive: its tissue, and film and load cell."""

import math

from display_node.plant.contact import ContactLaw
from protocol.tissue import StiffeningLaw
from sensing_node.press.probe import CLEARANCE_M
from sensing_node.sources.wrist import WristScene, WristSensors


class TissueContact(ContactLaw):
    """Contact of a probe with tissue that begins beyond the place where the probe rests."""

    def __init__(self, scene: WristScene) -> None:
        self.tissue = StiffeningLaw(scene.knee_n, scene.length_m)

    def position(self, force_n: float) -> float:
        """Return the position in m for a force, from the place of rest."""
        return math.inf if math.isinf(force_n) else CLEARANCE_M + self.tissue.depth_m(force_n)

    def force(self, position_m: float) -> float:
        """Return the force in N at a position."""
        return self.tissue.force_n(position_m - CLEARANCE_M)


def read_wrist(sensors: WristSensors, forces_n: list[float]) -> list[list[float]]:
    """Return film and load cell in N for the static forces under the probe, one a millisecond.

    The emulated board has no electrodes: an ECG of the scene is left out.
    """
    pressures_pa, noise, _ = sensors.next_samples(len(forces_n))
    triples = zip(pressures_pa, noise, forces_n, strict=True)
    return [list(sensors.sense(*each)) for each in triples]
