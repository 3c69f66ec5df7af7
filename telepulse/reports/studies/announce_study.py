"""The study of prediction with an ECG: errors with and without it, R waves, and faults of it."""

import itertools
import time
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np

from display_node.prediction.ensemble import Ensemble
from display_node.prediction.r_waves import RWaveDetector
from telepulse.parallel import in_one_thread, sweep
from telepulse.reports.studies.announce_detector import DetectorScore, score_lead
from telepulse.reports.studies.announce_oracle import OracleErrors, score_oracle
from telepulse.reports.studies.announce_pulses import (
    FAULTS,
    SYNTHETIC,
    AnnouncedPulse,
    EcgFault,
    announced_pulses,
    with_fault,
)
from telepulse.reports.studies.announce_records import (
    AnnotatedLead,
    annotated_leads,
    recorded_announced,
)
from telepulse.reports.studies.prediction_pulses import RATE_HZ, SCORED_FROM_S, Floats
from telepulse.reports.studies.prediction_study import (
    FRAME,
    HORIZONS_MS,
    instant_ns,
    observe_frame,
)

# Jitters of the transit time; without any, the errors are the least that the predictor can have.
JITTERS_S, NO_JITTER_S = (0.005, 0.02), 0.0
# From FOUND_OUT_S after a fault on, the ECG is to be unused.
FAULT_FROM_S, FOUND_OUT_S = 25.0, 3.0


@dataclass(frozen=True, slots=True)
class AnnounceEffort:
    """Amount of computing. The defaults are the study's; tests use less.

    seeds: of the pulses without a shape cue; the others are drawn from the first one.
    """

    seconds: float = 60.0
    recorded_seconds: float = 200.0
    cost_rounds: int = 5
    seeds: tuple[int, ...] = (1, 2, 3, 4, 5)


class BothErrors(NamedTuple):
    """NRMSE at each horizon without and with the ECG, and the transit time found, of one run."""

    name: str
    without: tuple[float, ...]
    announced: tuple[float, ...]
    transit_ms: float
    deviation_ms: float
    used: float


class PulseErrors(NamedTuple):
    """Errors of a pulse drawn from several seeds; of a recording there is one run."""

    name: str
    runs: tuple[BothErrors, ...]

    @property
    def without(self) -> tuple[float, ...]:
        """Mean NRMSE of the runs at each horizon without the ECG."""
        return tuple(np.mean([run.without for run in self.runs], axis=0).tolist())

    @property
    def announced(self) -> tuple[float, ...]:
        """Mean NRMSE of the runs at each horizon with the ECG."""
        return tuple(np.mean([run.announced for run in self.runs], axis=0).tolist())

    @property
    def worst(self) -> tuple[float, ...]:
        """Greatest NRMSE of the runs at each horizon with the ECG."""
        return tuple(np.max([run.announced for run in self.runs], axis=0).tolist())

    @property
    def greatest_rise(self) -> float:
        """Greatest relative rise of the NRMSE by the ECG, of all runs and horizons."""
        return max(_greatest_rise(run.without, run.announced) for run in self.runs)

    @property
    def transit_ms(self) -> float:
        """Mean transit time."""
        return float(np.mean([run.transit_ms for run in self.runs]))

    @property
    def deviation_ms(self) -> float:
        """Mean deviation of the transit time."""
        return float(np.mean([run.deviation_ms for run in self.runs]))

    @property
    def used(self) -> float:
        """Share of the time in which the ECG was used."""
        return float(np.mean([run.used for run in self.runs]))


class FoundOut(NamedTuple):
    """A fault of the ECG, and what came of it.

    seconds: from the fault until the ECG was no longer used. used: share of the time from 3 s after
    the fault on in which it was. early, late: NRMSE at 100 ms without and with the ECG in these 3 s
    and from then on. rise: greatest relative rise of the NRMSE by the ECG from then on.
    """

    pulse: str
    fault: str
    seconds: float
    used: float
    early: tuple[float, float]
    late: tuple[float, float]
    rise: float


@dataclass(frozen=True, slots=True)
class AnnounceScores:
    """Scores of the study. errors: by the jitter in s of the transit time, or 0 for recordings.

    limit: errors of the synthetic pulses with a transit time that does not vary.
    cost_ratio: processor time of a step with announcement over one without.
    """

    errors: dict[float, list[PulseErrors]]
    faults: list[FoundOut]
    detector: list[DetectorScore]
    cost_ratio: float
    limit: tuple[PulseErrors, ...] = ()
    oracle: tuple[OracleErrors, ...] = ()


class AnnouncedRun(NamedTuple):
    """A run of the predictor: squared errors by frame and horizon, and by frame, whether used."""

    squares: Floats
    used: Floats
    stack: Ensemble


def run(announced: AnnouncedPulse, with_ecg: bool) -> AnnouncedRun:
    """Predict a pulse frame by frame, with or without its ECG.

    After each frame, one prediction is made for each horizon, as in the study of predictors.
    """
    pulse, ecg_mv = announced
    stack, detector = Ensemble("stack"), RWaveDetector()
    count = (len(pulse.true) - max(HORIZONS_MS) * RATE_HZ // 1000) // FRAME - 1
    squares, used = np.zeros((count, len(HORIZONS_MS))), np.zeros(count)
    for frame in range(count):
        observe_frame(stack, pulse.sensed, frame)
        if with_ecg:
            stack.announce(observe_frame(detector, ecg_mv, frame))
        transit = stack.transit
        used[frame] = transit is not None and transit.reliable
        for tick in range(FRAME):
            stack.work()
            if tick == frame % FRAME:
                newest = frame * FRAME + FRAME - 1
                at = [newest + horizon_ms * RATE_HZ // 1000 for horizon_ms in HORIZONS_MS]
                found = np.array([stack.predict(instant_ns(each)) for each in at])
                squares[frame] = (found - pulse.true[at]) ** 2
    return AnnouncedRun(squares, used, stack)


def nrmse(squares: Floats, from_s: float, to_s: float = np.inf) -> tuple[float, ...]:
    """Return the root mean square at each horizon between two times."""
    frames = np.arange(len(squares)) * FRAME / RATE_HZ
    chosen = squares[(frames >= from_s) & (frames < to_s)]
    return tuple(np.sqrt(chosen.mean(axis=0)).tolist())


def _greatest_rise(without: tuple[float, ...], announced: tuple[float, ...]) -> float:
    """Return the greatest relative rise of the error at any horizon."""
    return max(after / before - 1 for before, after in zip(without, announced, strict=True))


def score_both(versions: tuple[AnnouncedPulse, ...]) -> list[BothErrors]:
    """Predict a pulse without an ECG, and with each of several ECGs."""
    without = nrmse(run(versions[0], False).squares, SCORED_FROM_S)
    return [_score_with(each, without) for each in versions]


def _score_with(announced: AnnouncedPulse, without: tuple[float, ...]) -> BothErrors:
    with_ecg = run(announced, True)
    transit, step_ms = with_ecg.stack.transit, 5.0
    known = transit is not None and transit.median is not None
    return BothErrors(
        str(announced),
        without,
        nrmse(with_ecg.squares, SCORED_FROM_S),
        step_ms * (transit.median or np.nan) if known and transit else np.nan,
        step_ms * transit.deviation if known and transit else np.nan,
        float(with_ecg.used[round(SCORED_FROM_S * RATE_HZ) // FRAME :].mean()),
    )


def score_faults(announced: AnnouncedPulse) -> list[FoundOut]:
    """Score each fault of a pulse's ECG."""
    without = run(announced, False).squares
    return [score_fault(announced, fault, without) for fault in FAULTS]


def score_fault(announced: AnnouncedPulse, fault: EcgFault, without: Floats) -> FoundOut:
    """Return when a fault of the ECG is found out, for how long it is used, and the errors.

    without: squared errors of the pulse without an ECG.
    """
    with_ecg = run(with_fault(announced, fault, FAULT_FROM_S), True)
    used = with_ecg.used[round(FAULT_FROM_S * RATE_HZ) // FRAME :]
    unused = np.flatnonzero(used == 0)
    seconds = unused[0] * FRAME / RATE_HZ if len(unused) else np.inf
    column, late_s = HORIZONS_MS.index(100), FAULT_FROM_S + FOUND_OUT_S
    both = without, with_ecg.squares
    early = [nrmse(squares, FAULT_FROM_S, late_s)[column] for squares in both]
    late = [nrmse(squares, late_s) for squares in both]
    return FoundOut(
        str(announced),
        fault.name,
        float(seconds),
        float(used[round(FOUND_OUT_S * RATE_HZ) // FRAME :].mean()),
        (early[0], early[1]),
        (late[0][column], late[1][column]),
        _greatest_rise(*late),
    )


def measure_cost_ratio(case: tuple[AnnouncedPulse, int]) -> float:
    """Return the processor time of frames with an ECG over that without, the least of rounds."""
    announced, rounds = case
    taken: dict[bool, list[float]] = {False: [], True: []}
    for _ in range(rounds):
        for with_ecg, each in taken.items():
            began_s = time.process_time()
            run(announced, with_ecg)
            each.append(time.process_time() - began_s)
    return min(taken[True]) / min(taken[False])


def score_announce(
    effort: AnnounceEffort, records: Path | None = None, scheduler: str | None = None
) -> AnnounceScores:
    """Score everything, on all cores or a Dask cluster; then measure the cost here.

    records: a folder with records 100, 03700181 and a103l of PhysioNet, as in wfdb's sample data.

    Raises SourceError or SweepError.
    """
    # The same pulses for each jitter of the transit time; by seed and name, the versions' ECGs.
    first, cases = effort.seeds[0], list[tuple[AnnouncedPulse, ...]]()
    for seed in effort.seeds:
        sets = [
            announced_pulses(effort.seconds, seed, jitter_s)
            for jitter_s in (*JITTERS_S, NO_JITTER_S)
        ]
        versions = list(zip(*sets, strict=True))
        cases += versions if seed == first else versions[: len(SYNTHETIC)]
    basis = [versions[0] for versions in cases[: len(SYNTHETIC)]]
    leads: list[AnnotatedLead] = []
    if records is not None:
        cases += [(each,) for each in recorded_announced(records, effort.recorded_seconds)]
        leads = annotated_leads(records)
    runs: dict[float | None, dict[str, list[BothErrors]]] = {}
    for found in sweep(score_both, cases, scheduler):
        keys = (*JITTERS_S, None) if len(found) > 1 else (0.0,)
        for key, each in zip(keys, found, strict=True):
            runs.setdefault(key, {}).setdefault(each.name, []).append(each)
    limit = _by_pulse(runs.pop(None))
    errors = {key: _by_pulse(by_name) for key, by_name in runs.items() if key is not None}
    lengths = [
        (each.name, effort.seconds, seed, JITTERS_S[0])
        for each in errors[JITTERS_S[0]]
        for seed in effort.seeds[: len(each.runs)]
    ]
    oracle = tuple(sweep(score_oracle, lengths, scheduler))
    faults = list(itertools.chain.from_iterable(sweep(score_faults, basis, scheduler)))
    detector = sweep(score_lead, leads, scheduler) if leads else []
    ratio = in_one_thread(measure_cost_ratio, (basis[0], effort.cost_rounds))
    return AnnounceScores(errors, faults, detector, ratio, tuple(limit), oracle)


def _by_pulse(runs: dict[str, list[BothErrors]]) -> list[PulseErrors]:
    return [PulseErrors(name, tuple(each)) for name, each in runs.items()]
