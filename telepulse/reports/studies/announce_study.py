"""The study of prediction with an ECG: errors with and without it, R waves, and faults of it."""

import itertools
import time
from bisect import bisect_right
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np

from display_node.prediction.ensemble import Ensemble
from display_node.prediction.r_waves import RWaveDetector
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
    TICK_NS,
    instant_ns,
    observe_frame,
)
from telepulse.reports.studies.sweep import in_one_thread, sweep

# Jitters of the transit time; without any, the errors are the least that the predictor can have.
JITTERS_S, NO_JITTER_S = (0.005, 0.02), 0.0
# From FOUND_OUT_S after a fault on, the ECG is to be unused.
FAULT_FROM_S, FOUND_OUT_S = 25.0, 3.0
# ANSI/AAMI EC57: a detection within 150 ms of an annotated beat is that beat. Its learning period
# of five minutes is not used: only the first 5 s do not count.
MATCH_S, MATCHED_FROM_S = 0.15, 5.0


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


class DetectorScore(NamedTuple):
    """R waves found of a lead against its annotations: counts, and latency in ms."""

    lead: str
    beats: int
    missed: int
    false: int
    deviation_ms: float
    latency_ms: float

    @property
    def sensitivity(self) -> float:
        """Share of the annotated beats that were found."""
        return 1 - self.missed / self.beats

    @property
    def precision(self) -> float:
        """Share of the R waves found that are annotated beats."""
        found = self.beats - self.missed
        return found / (found + self.false)


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
    stack, detector = Ensemble("stack", TICK_NS), RWaveDetector()
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


def score_lead(lead: AnnotatedLead) -> DetectorScore:
    """Find the R waves of a lead frame by frame, and match them with its annotations."""
    detector, found_s, latencies_s = RWaveDetector(), [], []
    times_ns = np.round(np.arange(len(lead.ecg_mv)) * 1e9 / lead.rate_hz).astype(int).tolist()
    values = lead.ecg_mv.tolist()
    for first in range(0, len(values), FRAME):
        for wave in detector.observe(
            times_ns[first : first + FRAME], values[first : first + FRAME]
        ):
            found_s.append(wave.at_ns * 1e-9)
            latencies_s.append((wave.found_ns - wave.at_ns) * 1e-9)
    beats_s: list[float] = lead.beats_s.tolist()
    pairs = _match(beats_s, found_s)
    scored = range(bisect_right(beats_s, MATCHED_FROM_S), len(beats_s))
    missed = len(set(scored) - {beat for beat, _ in pairs})
    matched = {found for _, found in pairs}
    candidates = range(
        bisect_right(found_s, MATCHED_FROM_S), bisect_right(found_s, beats_s[-1] + MATCH_S)
    )
    errors_s = [found_s[found] - beats_s[beat] for beat, found in pairs if beat in scored]
    return DetectorScore(
        lead.name,
        len(scored),
        missed,
        len(set(candidates) - matched),
        1e3 * float(np.std(errors_s)) if errors_s else np.nan,
        1e3 * float(np.median(latencies_s)),
    )


def _match(beats_s: list[float], found_s: list[float]) -> list[tuple[int, int]]:
    """Return the places of matched beats and R waves; each R wave matches one beat, in order."""
    pairs, position = [], 0
    for beat, beat_s in enumerate(beats_s):
        while position < len(found_s) and found_s[position] < beat_s - MATCH_S:
            position += 1
        if position < len(found_s) and found_s[position] <= beat_s + MATCH_S:
            pairs.append((beat, position))
            position += 1
    return pairs


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
    faults = list(itertools.chain.from_iterable(sweep(score_faults, basis, scheduler)))
    detector = sweep(score_lead, leads, scheduler) if leads else []
    ratio = in_one_thread(measure_cost_ratio, (basis[0], effort.cost_rounds))
    return AnnounceScores(errors, faults, detector, ratio, tuple(limit))


def _by_pulse(runs: dict[str, list[BothErrors]]) -> list[PulseErrors]:
    return [PulseErrors(name, tuple(each)) for name, each in runs.items()]
