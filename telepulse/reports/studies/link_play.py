"""One way to play one link: so much buffered, the rest predicted, both nodes in virtual time."""

import math
from collections.abc import Iterable
from dataclasses import dataclass, fields, replace

import numpy as np
from numpy.typing import NDArray

from display_node.prediction import PredictorName
from display_node.scoring.tracking_error import JND
from protocol.tactile import matching_force_ratio
from protocol.wire.telemetry import TickState
from sensing_node.scene import build_source
from telepulse.scene import Scene, find_scene, load_scene
from telepulse.simulation.link_model import parse_link
from telepulse.simulation.virtual_time import Simulation

SCENE = "radial"
AUTO = "auto"

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class LinkEffort:
    """How long is played: `settle_seconds` to learn in, then `seconds` that count."""

    seconds: float = 15.0
    settle_seconds: float = 20.0
    seeds: tuple[int, ...] = (1, 2)


@dataclass(frozen=True, slots=True)
class LinkCell:
    """A link as `parse_link` reads it, a predictor, a perceived delay E and a seed.

    delay_ms: None where the display chooses E. The seed is the link's and the pulse's.
    """

    link: str
    predictor: PredictorName
    delay_ms: float | None
    seed: int = 1

    def __str__(self) -> str:
        delay = AUTO if self.delay_ms is None else f"{self.delay_ms:g} ms"
        return f"{self.predictor} at E = {delay} over {self.link}, seed {self.seed}"


@dataclass(frozen=True, slots=True)
class LinkOutcome:
    """What came of it. deviation_n and peak_to_peak_n: the pulse's own, as felt.

    delay_ms: mean perceived delay E, so much is buffered. horizon_ms: by how much the newest
    sample was older than what was played, so much is predicted, on average; longest_ms: at most.
    predicted: share of ticks without a sample. felt: share of the time in which the pulse was
    felt, and not faded out for want of samples. roughness: energy of what is felt above 25 Hz
    over the pulse's. late, lost: shares of the samples.
    """

    in_phase_n: float
    aligned_n: float
    deviation_n: float
    peak_to_peak_n: float
    delay_ms: float
    horizon_ms: float
    longest_ms: float
    predicted: float
    felt: float
    roughness: float
    late: float
    lost: float

    @property
    def in_phase(self) -> float:
        """NRMSE against the pulse at that very instant."""
        return self.in_phase_n / self.deviation_n

    @property
    def aligned(self) -> float:
        """NRMSE against the pulse of E ago."""
        return self.aligned_n / self.deviation_n

    @property
    def in_phase_jnd(self) -> float:
        """The error in phase over the least difference in force that is felt."""
        return self.in_phase_n / (JND * self.peak_to_peak_n)


def play(cell: LinkCell, effort: LinkEffort) -> LinkOutcome:
    """Play a cell. Raises SceneError."""
    scene = _scene(cell)
    simulation = Simulation(scene, cell.seed)
    delays_ns, horizons_ns = [], []

    def watch(felt: TickState) -> None:
        newest_ns = simulation.newest_ns
        if newest_ns is not None:
            delays_ns.append(felt.playout_delay_ns)
            horizons_ns.append(max(0, felt.instant_ns - newest_ns))

    summary = simulation.run(effort.settle_seconds + effort.seconds, effort.settle_seconds, watch)
    samples, errors = summary.samples, summary.force_rmse_n
    horizon_ns, pulse_n = np.array(horizons_ns), _pulse_n(scene, effort)
    return LinkOutcome(
        in_phase_n=errors.in_phase or math.nan,
        aligned_n=errors.aligned or math.nan,
        deviation_n=float(pulse_n.std()),
        peak_to_peak_n=float(np.ptp(pulse_n)),
        delay_ms=float(np.mean(delays_ns)) * 1e-6,
        horizon_ms=float(horizon_ns.mean()) * 1e-6,
        longest_ms=float(horizon_ns.max()) * 1e-6,
        predicted=float(np.mean(horizon_ns > 0)),
        felt=len(delays_ns) * scene.display.tick_ns * 1e-9 / effort.seconds,
        roughness=summary.roughness.energy_ratio or math.nan,
        late=(samples.late or 0) / (samples.sent or 1),
        lost=(samples.lost or 0) / (samples.sent or 1),
    )


def pooled(outcomes: Iterable[LinkOutcome]) -> LinkOutcome:
    """One outcome of several seeds: forces by their root mean square, the rest by its mean."""
    several = list(outcomes)
    values = {}
    for field in fields(LinkOutcome):
        column = np.array([getattr(outcome, field.name) for outcome in several])
        is_force = field.name.endswith("_n")
        values[field.name] = float(np.sqrt(np.mean(column**2)) if is_force else column.mean())
    longest_ms = max(outcome.longest_ms for outcome in several)
    return replace(LinkOutcome(**values), longest_ms=longest_ms)


def _scene(cell: LinkCell) -> Scene:
    scene = load_scene(find_scene(SCENE))
    source = scene.sensing.source.model_copy(update={"seed": cell.seed})
    delay_ns = None if cell.delay_ms is None else round(cell.delay_ms * 1e6)
    display = {"predictor": cell.predictor, "compensation_ns": delay_ns}
    return replace(
        scene,
        sensing=scene.sensing.model_copy(update={"source": source}),
        display=scene.display.model_copy(update=display),
        link=parse_link(cell.link),
    )


def _pulse_n(scene: Scene, effort: LinkEffort) -> Floats:
    """What should be felt while it is scored."""
    source = build_source(scene.sensing, scene.path.parent)
    rate_hz = 1e9 / source.period_ns
    source.take(round(effort.settle_seconds * rate_hz))
    wrist_n = source.take(round(effort.seconds * rate_hz))[:, scene.display.channel]
    ratio = matching_force_ratio(scene.sensing.layer.layer(), scene.display.layer.layer())
    return np.asarray(ratio * wrist_n, dtype=np.float64)
