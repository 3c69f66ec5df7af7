"""Study of a recorded pulse over a link: how well it is predicted, and what a finger would feel."""

from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from display_node.prediction import Predictor, PredictorName, build_predictors
from display_node.prediction.r_waves import RWaveDetector
from display_node.prediction.scene import own_predictor
from display_node.prediction.trust import DelayChoice
from protocol.errors import SourceError
from protocol.faults import Note
from protocol.tactile import JND, matching_force_ratio
from protocol.ticks import TickState
from pulse_sensors.sample_plausibility import SampleCheck
from sensing_node.feeds import sensor_notes
from sensing_node.scene import build_source, describe_stream
from sensing_node.sources.recorded import beat_height
from telepulse.scene import Scene
from telepulse.simulation.virtual_time import Simulation

Floats = NDArray[np.float64]
# The predictor has learnt a regular pulse after some 10 s; what follows LEARNING_S is scored.
LEARNING_S: Final = 15.0
LEAST_S: Final = 20.0
AHEAD_MS: Final = (20, 50, 100, 150, 200)
PREDICTOR: Final[PredictorName] = "stack"
# Name, predictor and E in ns of each playout; None chooses E. Nothing trusts `linear`, so that
# with it E covers the link's whole delay.
PLAYOUTS: Final[tuple[tuple[str, PredictorName, int | DelayChoice], ...]] = (
    ("buffered", "linear", "auto"),
    ('E = "auto"', PREDICTOR, "auto"),
    ("E = 0", PREDICTOR, 0),
)


class ErrorAhead(NamedTuple):
    """RMS errors in N at a time after the newest sample: of prediction, and of holding it."""

    ahead_ms: int
    predicted_n: float
    held_n: float


@dataclass(frozen=True, slots=True)
class FeltPlayout:
    """Figures of the force felt with a playout; None where nothing was felt.

    delay_ms: mean perceived delay. in_phase_n, aligned_n: RMS errors of the felt force, against the
    present pulse and against the one that long ago. noticed: share of the time in which a finger
    notices the latter error. late: share of the samples that arrived after
    their instant, which was felt from a prediction. lost: share that never arrived.
    """

    name: str
    delay_ms: float | None
    in_phase_n: float | None
    aligned_n: float | None
    noticed: float | None
    late: float
    lost: float


@dataclass(frozen=True, slots=True)
class RecordStudy:
    """Results of a study. Forces are those at the finger.

    seconds: of the recording that were used, the first `LEARNING_S` of them unscored. height_n: of
    a usual beat. notes: what is doubtful in the recording, such as gaps that were filled.
    """

    seconds: float
    height_n: float
    ahead: tuple[ErrorAhead, ...]
    playouts: tuple[FeltPlayout, ...]
    notes: tuple[Note, ...]

    @property
    def advice(self) -> str:
        """Advice on `compensation`, with the error that would be felt."""
        buffered, auto, _ = self.playouts
        if auto.in_phase_n is None or buffered.in_phase_n is None:
            return "Nothing would be felt over this link."
        alone = self._share(buffered.in_phase_n)
        advice = (
            f'Leave compensation = "auto": the pulse is felt {auto.delay_ms or 0:z.0f} ms after the'
            f" wrist, off by {self._share(auto.in_phase_n)} of its height in phase, and a finger"
            f" notices an error (of {100 * JND:.0f} % or more) for"
            f" {100 * (auto.noticed or 0):.1f} % of the time. Buffered alone it is felt"
            f" {buffered.delay_ms or 0:.0f} ms after the wrist, off by {alone} in phase"
        )
        if auto.in_phase_n > JND * self.height_n:
            advice += "; this pulse cannot be predicted well enough to be felt at once"
        return f"{advice}."

    def _share(self, force_n: float) -> str:
        return f"{100 * force_n / self.height_n:.1f} %"

    def to_dict(self) -> dict[str, Any]:
        """Return the results as plain types for JSON."""
        ahead = [each._asdict() for each in self.ahead]
        return asdict(self) | {"ahead": ahead, "learning_s": LEARNING_S, "advice": self.advice}


def study_record(
    scene: Scene, most_s: float, seed: int, progress: Callable[[float], None]
) -> RecordStudy:
    """Predict a scene's recording, and play it over the scene's link.

    Parameters
    ----------
    scene
        Scene whose source is a recording, and which has one contactor.
    most_s
        The recording's beginning of this length in s is used, from `LEAST_S` on.
    seed
        Seed of the link.
    progress
        Receives the time in s that is simulated by now, of `len(PLAYOUTS)` times the length.

    Raises
    ------
    SourceError
        If the recording cannot be read, or is shorter than `LEAST_S`.
    """
    source = build_source(scene.sensing, scene.path.parent)
    stream = describe_stream(scene.sensing, source)
    length_s = source.repeats_after_s or 0.0
    if length_s < LEAST_S:
        raise SourceError(
            f"{stream.name}: lasts {length_s:.1f} s; a study needs at least {LEAST_S:g} s, of which"
            f" the predictor learns for {LEARNING_S:g} s"
        )
    seconds = min(most_s, length_s)
    samples = source.take(int(seconds * 1e9 / stream.period_ns))
    ratio = matching_force_ratio(scene.sensing.layer.layer(), scene.display.layer.layer())
    force_n = ratio * samples[:, stream.find_force(scene.display.channel)]
    ecg = None if stream.announcing is None else samples[:, stream.announcing]
    check = SampleCheck(stream.period_ns, stream.channels)
    check.add(samples)
    playouts = tuple(
        _play(scene, number, seconds, seed, progress) for number in range(len(PLAYOUTS))
    )
    return RecordStudy(
        seconds,
        beat_height(force_n, 1e9 / stream.period_ns),
        errors_ahead(force_n, stream.period_ns, stream.batch, ecg),
        playouts,
        tuple(sensor_notes(source, check)),
    )


def errors_ahead(
    force_n: Floats, period_ns: int, batch: int, ecg: Floats | None = None
) -> tuple[ErrorAhead, ...]:
    """Return the errors at `AHEAD_MS` after the newest sample, as a display would predict it.

    Parameters
    ----------
    force_n
        The pulse, of at least `LEARNING_S` and the longest time ahead.
    period_ns, batch
        Time between samples, and their number in a frame.
    ecg
        ECG that announces the beats, at the same times; None for none.
    """
    predictor: Predictor = build_predictors(PREDICTOR)[0]
    detector, t_ns = RWaveDetector(), np.arange(len(force_n)) * period_ns
    ahead_ns = np.array(AHEAD_MS) * 1_000_000
    newest, predicted_n = [], []
    for first in range(0, len(force_n) - batch + 1, batch):
        last = first + batch
        times_ns = t_ns[first:last].tolist()
        if times_ns[-1] + ahead_ns[-1] > t_ns[-1]:
            break
        predictor.observe(times_ns, force_n[first:last].tolist())
        if ecg is not None:
            predictor.announce(detector.observe(times_ns, ecg[first:last].tolist()))
        while predictor.work():
            pass
        if times_ns[-1] >= LEARNING_S * 1e9:
            newest.append(last - 1)
            predicted_n.append([predictor.predict(int(times_ns[-1] + each)) for each in ahead_ns])
    true_n = np.interp(t_ns[newest][:, np.newaxis] + ahead_ns, t_ns, force_n)
    held_n = force_n[newest][:, np.newaxis]
    predicted, held = (
        np.sqrt(np.mean((each - true_n) ** 2, axis=0)).tolist()
        for each in (np.array(predicted_n), held_n)
    )
    return tuple(map(ErrorAhead, AHEAD_MS, predicted, held))


def _play(
    scene: Scene, number: int, seconds: float, seed: int, progress: Callable[[float], None]
) -> FeltPlayout:
    """Simulate one of `PLAYOUTS`."""
    name, predictor, compensation_ns = PLAYOUTS[number]
    changes = {"predictor": own_predictor(predictor), "compensation_ns": compensation_ns}
    changed = replace(scene, display=scene.display.model_copy(update=changes))
    delays_ns: list[int] = []

    def watch(tick: TickState) -> None:
        delays_ns.append(tick.playout_delay_ns)

    summary = Simulation(changed, seed).run(
        seconds, LEARNING_S, watch, lambda done_s: progress(number * seconds + min(done_s, seconds))
    )
    samples, errors = summary.samples, summary.force_rmse_n
    sent = samples.sent or 1
    return FeltPlayout(
        name,
        float(np.mean(delays_ns)) * 1e-6 if delays_ns else None,
        errors.in_phase,
        errors.aligned,
        None if summary.within_jnd is None else 1 - summary.within_jnd,
        ((samples.late or 0) + (samples.predicted or 0)) / sent,
        (samples.lost or 0) / sent,
    )
