"""Errors of prediction with an ECG and without, R waves, and what a wrong ECG does.

Other ECGs than the drawn ones are those of `--records FOLDER` (`benchmarks/announce/records.py`).
"""

import itertools
import time
from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

from benchmarks.announce.records import annotated_leads, recorded_announced
from benchmarks.benchmark import Benchmark
from telepulse.parallel import in_one_thread
from tests.support.announced_pulses import (
    FAULTS,
    JUMP,
    SYNTHETIC,
    AnnouncedPulse,
    EcgFault,
    announced_pulses,
    nrmse,
    run,
    with_fault,
)
from tests.support.drawn_pulses import FRAME, HORIZONS_MS, RATE_HZ, SCORED_FROM_S, Floats, Pulse
from tests.support.r_wave_scores import score_lead

# Jitters of the transit time; without any, the errors are the least that the predictor can have.
JITTERS_S = (0.005, 0.02, 0.0)
# From FOUND_OUT_S after a fault on, the ECG is to be unused.
FAULT_FROM_S, FOUND_OUT_S = 25.0, 3.0
RECORDED_S = 200.0
HORIZONS = tuple(f"{each} ms" for each in HORIZONS_MS)
AT_100_MS = HORIZONS_MS.index(100)


class BothErrors(NamedTuple):
    """NRMSE at each horizon without and with the ECG, and the transit time found, of one run."""

    name: str
    without: tuple[float, ...]
    announced: tuple[float, ...]
    transit_ms: float
    deviation_ms: float
    used: float


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


# Runs of each pulse, one a seed; of a recording there is one.
Runs = dict[str, list[BothErrors]]


def main(benchmark: Benchmark) -> None:
    """Print the tables."""
    quick, records = benchmark.quick, benchmark.records
    seconds, jitters_s = (28.3, JITTERS_S[:1]) if quick else (60.0, JITTERS_S)
    seeds = range(1, 2 if quick else (benchmark.seeds or 5) + 1)
    # The same pulses for each jitter of the transit time. Those with a shape cue are drawn once.
    cases = list[tuple[int, tuple[AnnouncedPulse, ...]]]()
    for seed in seeds:
        sets = [announced_pulses(seconds, seed, jitter_s) for jitter_s in jitters_s]
        versions = list(zip(*sets, strict=True))[: None if seed == 1 else len(SYNTHETIC)]
        cases += [(seed, each) for each in versions]
    cases = cases[:1] if quick else cases
    basis = [versions[0] for _, versions in cases[: len(SYNTHETIC)]]
    found = benchmark.run(score_both, [versions for _, versions in cases])
    for place, jitter_s in enumerate(jitters_s):
        errors = _by_name(each[place] for each in found)
        _show_errors(benchmark, f"Transit time varies by {1e3 * jitter_s:g} ms", errors)
        if quick:
            continue
        if jitter_s == JITTERS_S[0]:
            _judge_errors(benchmark, errors)
        elif jitter_s == JITTERS_S[1]:
            what = "greatest rise of an error where the transit time varies by 20 ms"
            benchmark.judge(what, _greatest_rise_of(errors))
    if records is not None:
        recorded = recorded_announced(records, RECORDED_S)
        errors = _by_name(both for (both,) in benchmark.run(score_both, [(r,) for r in recorded]))
        _show_errors(benchmark, f"Recordings, {RECORDED_S:g} s", errors)
        rise = _greatest_rise_of(errors)
        benchmark.judge("greatest rise of an error of the recordings", rise)
        _show_leads(benchmark)
    faults = benchmark.run(score_faults, [(each, 1 if quick else len(FAULTS)) for each in basis])
    _show_faults(benchmark, list(itertools.chain.from_iterable(faults)))
    timed, rounds = (_beginning(basis[0]), 1) if quick else (basis[0], 5)
    ratio = in_one_thread(measure_cost_ratio, (timed, rounds))
    benchmark.table("Cost", ("processor time", "ratio"), [("with the ECG", f"{ratio:.2f}")])
    benchmark.judge("processor time with the ECG over that without", ratio)


def _by_name(found: Iterable[BothErrors]) -> Runs:
    runs: Runs = {}
    for each in found:
        runs.setdefault(each.name, []).append(each)
    return runs


def _show_errors(benchmark: Benchmark, title: str, errors: Runs) -> None:
    rows = []
    for name, runs in errors.items():
        without, announced = _means(runs)
        transit_ms, deviation_ms, used = np.mean([each[3:] for each in runs], axis=0)
        cells = (f"{one:.3f} / {other:.3f}" for one, other in zip(without, announced, strict=True))
        rows.append((name, *cells, f"{transit_ms:.0f} ± {deviation_ms:.0f}", f"{used:.0%}"))

    benchmark.table(
        title,
        ("pulse", *HORIZONS, "transit time, ms", "used"),
        rows,
        f"NRMSE after {SCORED_FROM_S:g} s, mean of the seeds: without / with the ECG.",
    )


def _means(runs: list[BothErrors]) -> tuple[list[float], list[float]]:
    """Return the mean errors at each horizon without and with the ECG."""
    without, announced = ([run.without for run in runs], [run.announced for run in runs])
    return np.mean(without, axis=0).tolist(), np.mean(announced, axis=0).tolist()


def _judge_errors(benchmark: Benchmark, errors: Runs) -> None:
    for name, runs in errors.items():
        at_100_ms = [run.announced[AT_100_MS] for run in runs]
        benchmark.judge(f"{name}, 100 ms ahead: mean of the seeds", float(np.mean(at_100_ms)))
        if name in SYNTHETIC:
            benchmark.judge(f"{name}, 100 ms ahead: worst of the seeds", max(at_100_ms))


def _greatest_rise(without: tuple[float, ...], announced: tuple[float, ...]) -> float:
    """Return the greatest relative rise of the error at any horizon."""
    return max(after / before - 1 for before, after in zip(without, announced, strict=True))


def _greatest_rise_of(errors: Runs) -> float:
    runs = [each for runs in errors.values() for each in runs]
    return max(_greatest_rise(each.without, each.announced) for each in runs)


def _show_leads(benchmark: Benchmark) -> None:
    assert benchmark.records is not None
    scores = benchmark.run(score_lead, annotated_leads(benchmark.records))
    benchmark.table(
        "R waves within 150 ms of annotated ones",
        ("lead", "beats", "sensitivity", "precision", "deviation, ms", "latency, ms"),
        [
            (
                *(each.lead, f"{each.beats}", f"{each.sensitivity:.4f}", f"{each.precision:.4f}"),
                *(f"{each.deviation_ms:.1f}", f"{each.latency_ms:.0f}"),
            )
            for each in scores
        ],
    )
    for figure in ("sensitivity", "precision"):
        least = min(getattr(each, figure) for each in scores)
        benchmark.judge(f"{figure} of the R waves of annotated records", least)


def _show_faults(benchmark: Benchmark, faults: list[FoundOut]) -> None:
    window = f"{FOUND_OUT_S:g} s"
    benchmark.table(
        f"An ECG that is wrong from {FAULT_FROM_S:g} s on",
        (
            *("pulse", "the ECG", "unused after, s", f"used from {window} on"),
            *(f"NRMSE in {window}", "NRMSE after", "rise after"),
        ),
        [
            (
                *(each.pulse, each.fault, f"{each.seconds:.2f}", f"{each.used:.1%}"),
                *(f"{without:.3f} / {wrong:.3f}" for without, wrong in (each.early, each.late)),
                f"{each.rise:+.1%}",
            )
            for each in faults
        ],
        "NRMSE 100 ms ahead: without / with the ECG. Rise: the greatest of all horizons.",
    )
    if benchmark.quick:
        return
    benchmark.judge("time until a wrong ECG is unused", max(each.seconds for each in faults))
    used = max(each.used for each in faults if each.fault != JUMP)
    benchmark.judge("use of a wrong ECG from then on", used)
    rise = max(each.late[1] / each.late[0] - 1 for each in faults if each.fault == JUMP)
    benchmark.judge("rise of the error 100 ms ahead from 3 s after a jump", rise)


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


def score_faults(case: tuple[AnnouncedPulse, int]) -> list[FoundOut]:
    """Score the first faults, of this number, of a pulse's ECG."""
    announced, count = case
    without = run(announced, False).squares
    return [_score_fault(announced, fault, without) for fault in FAULTS[:count]]


def _score_fault(announced: AnnouncedPulse, fault: EcgFault, without: Floats) -> FoundOut:
    """Return when a fault is found out, for how long the ECG is used, and the errors.

    without: squared errors of the pulse without an ECG.
    """
    with_ecg = run(with_fault(announced, fault, FAULT_FROM_S), True)
    used = with_ecg.used[round(FAULT_FROM_S * RATE_HZ) // FRAME :]
    unused = np.flatnonzero(used == 0)
    seconds = unused[0] * FRAME / RATE_HZ if len(unused) else np.inf
    late_s = FAULT_FROM_S + FOUND_OUT_S
    both: tuple[Floats, Floats] = without, with_ecg.squares
    early = [nrmse(squares, FAULT_FROM_S, late_s)[AT_100_MS] for squares in both]
    late = [nrmse(squares, late_s) for squares in both]
    return FoundOut(
        str(announced),
        fault.name,
        float(seconds),
        float(used[round(FOUND_OUT_S * RATE_HZ) // FRAME :].mean()),
        (early[0], early[1]),
        (late[0][AT_100_MS], late[1][AT_100_MS]),
        _greatest_rise(*late),
    )


def _beginning(announced: AnnouncedPulse) -> AnnouncedPulse:
    """Return the first 3 s."""
    pulse, last = announced.pulse, 3 * RATE_HZ
    short = Pulse(pulse.name, pulse.sensed[:last], pulse.true[:last])
    return AnnouncedPulse(short, announced.ecg_mv[:last])


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
