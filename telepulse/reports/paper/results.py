"""All that the report computes at some cost, once."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sensing_node.sources.synthetic import SyntheticScene
from telepulse.reports.paper import experiment, numbers, readings
from telepulse.reports.paper.experiment import ExperimentRun
from telepulse.reports.paper.pulse import beats, beats_with_slow_parts, deviation_n, raw_mean_n
from telepulse.reports.paper.readings import FILM_MV, ReadingOutcome
from telepulse.reports.paper.spectrum import RATE_HZ, SECONDS, Spectrum, welch
from telepulse.scene import Scene, find_scene, load_scene

SCENE = "paper"


@dataclass(frozen=True, slots=True)
class Simulated:
    """The paper's simulation in continuous time: wanted and felt force in N."""

    wanted_n: NDArray[np.float64]
    felt_n: NDArray[np.float64]

    @property
    def strain_rmse(self) -> float:
        """Eqs 23-25 of the strains by Table 3."""
        return readings.rmse(numbers.LAYER.strain(self.felt_n - self.wanted_n))


@dataclass(frozen=True, slots=True)
class Spectra:
    """Of the paper's pulse and of what else one might have taken the spectrum of."""

    paper: Spectrum
    mean_kept: Spectrum
    mean_removed: Spectrum
    wide: Spectrum


@dataclass(frozen=True, slots=True)
class PaperResults:
    """scene: the experiment's; height_n: the pulse from peak to peak in N, ours; doing_nothing:
    RMSE over peak to peak of a force that stays at the pulse's mean, over whole beats."""

    scene: Scene
    height_n: float
    outcomes: tuple[ReadingOutcome, ...]
    doing_nothing: float
    doing_nothing_first_s: float
    simulated: Simulated
    run: ExperimentRun
    spectra: Spectra

    @property
    def film_mv(self) -> ReadingOutcome:
        """The one reading that follows a pulse."""
        return next(outcome for outcome in self.outcomes if outcome.reading == FILM_MV)


def compute() -> PaperResults:
    """Everything, in a few seconds. Raises SceneError or SourceError."""
    scene = load_scene(find_scene(SCENE))
    source = scene.sensing.source
    assert isinstance(source, SyntheticScene), "scenes/paper.toml names a synthetic pulse"
    unit_n = beats("paper", readings.RATE_HZ, numbers.FIRST_S)
    wanted_n = source.peak_to_peak_n * unit_n
    return PaperResults(
        scene=scene,
        height_n=source.peak_to_peak_n,
        outcomes=readings.measure(),
        doing_nothing=deviation_n("paper"),
        doing_nothing_first_s=readings.rmse(unit_n),
        simulated=Simulated(wanted_n, readings.follow(FILM_MV, numbers.SIMULATION, wanted_n)),
        run=experiment.run(scene),
        spectra=_spectra(),
    )


def _spectra() -> Spectra:
    bare_n = beats("paper", RATE_HZ, SECONDS)
    return Spectra(
        paper=welch(beats_with_slow_parts("paper", RATE_HZ, SECONDS)),
        mean_kept=welch(bare_n + raw_mean_n("paper")),
        mean_removed=welch(bare_n - bare_n.mean()),
        wide=welch(beats_with_slow_parts("wide", RATE_HZ, SECONDS)),
    )
