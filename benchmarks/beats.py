"""Analysis of beats: what is found of drawn and recorded pulses, and what it costs.

The last table is the predictors' error after an artefact, from which they learn nothing.
"""

import itertools
import time
from importlib import import_module
from importlib.util import find_spec
from unittest.mock import patch

import heartpy
import numpy as np

from benchmarks.benchmark import Benchmark
from display_node.prediction.artefacts import ArtefactDetector
from display_node.prediction.ensemble import Ensemble
from display_node.scoring.beat_quality import GOOD
from display_node.scoring.beats import Beat
from tests.support.drawn_beats import (
    BATCH,
    FOUND_FROM_S,
    MOVED_FROM_S,
    MOVED_S,
    RATE_HZ,
    SECONDS,
    Floats,
    analysed,
    draw,
    frames,
    moved,
    noisy,
    prediction_errors_n,
    seconds,
    true_notch_s,
    true_onset_and_peak_s,
)
from tests.support.drawn_pulses import recorded_pulses

NEAR_S = 0.06


def good(beats: list[Beat]) -> list[Beat]:
    """Return the beats that are not doubtful."""
    return [beat for beat in beats if beat.quality is None or beat.quality >= GOOD]


def drawn_row(name: str, preset: str) -> tuple[str, ...]:
    """Return beats found, and the errors of a drawn pulse with 1 % of noise."""
    pulse = draw(name, preset)
    beats = analysed(frames(noisy(pulse.force_n)))
    onsets_s = np.array([seconds(beat.onset_ns) for beat in beats])
    errors_ms, found = [], 0
    expected = [at_s for at_s in pulse.beats_s if FOUND_FROM_S < at_s < SECONDS - 3.0]
    for at_s in expected:
        onset_s, peak_s = true_onset_and_peak_s(pulse, at_s)
        beat = beats[int(np.abs(onsets_s - onset_s).argmin())]
        error_s = seconds(beat.onset_ns) - onset_s
        if abs(error_s) < NEAR_S:
            found += 1
            notch_s = np.nan if beat.notch_ns is None else seconds(beat.notch_ns)
            errors_s = error_s, seconds(beat.peak_ns) - peak_s, notch_s - true_notch_s(pulse, at_s)
            errors_ms.append([1e3 * each for each in errors_s])
    # A beat without a notch makes the errors of the notch NaN.
    rms = [
        f"{np.sqrt(np.mean(each**2)):.2f} / {each.max():.2f}"
        for each in np.abs(np.array(errors_ms)).T
    ]
    return (
        f"{name}, {preset}",
        f"{found} of {len(expected)}",
        *rms,
        f"{len(good(beats)) / len(beats):.2f}",
    )


def peaks_row(name: str, preset: str) -> tuple[str, ...]:
    """Return how many drawn peaks this analysis, heartpy and neurokit2 find, and peaks beside.

    neurokit2 is no dependency; without it, its column is empty.
    """
    pulse = draw(name, preset)
    force_n = noisy(pulse.force_n)
    expected = [at_s for at_s in pulse.beats_s if FOUND_FROM_S < at_s < SECONDS - 3.0]
    true_s = np.array([true_onset_and_peak_s(pulse, at_s)[1] for at_s in expected])
    found, _ = heartpy.process(force_n, float(RATE_HZ))
    peaks = {
        "here": np.array([seconds(beat.peak_ns) for beat in analysed(frames(force_n))]),
        "heartpy": np.array(found["peaklist"])[np.array(found["binary_peaklist"], bool)] / RATE_HZ,
    }
    if find_spec("neurokit2") is not None:
        neurokit = import_module("neurokit2")
        cleaned = neurokit.ppg_clean(force_n, RATE_HZ)
        peaks["neurokit2"] = neurokit.ppg_findpeaks(cleaned, RATE_HZ)["PPG_Peaks"] / RATE_HZ
    cells = []
    for peaks_s in peaks.values():
        within_s = peaks_s[(peaks_s > true_s[0] - NEAR_S) & (peaks_s < true_s[-1] + NEAR_S)]
        near = sum(np.abs(within_s - at_s).min() < NEAR_S for at_s in true_s)
        beside = sum(np.abs(true_s - at_s).min() >= NEAR_S for at_s in within_s)
        cells.append(f"{near} of {len(true_s)}, {beside} beside")
    return f"{name}, {preset}", *cells, *[""] * (3 - len(cells))


def recorded_row(name: str, force_n: Floats) -> tuple[str, ...]:
    """Return beats found, against the peaks that heartpy accepts in the whole recording."""
    beats = good(analysed(frames(force_n)))
    found, _ = heartpy.process(force_n, float(RATE_HZ))
    accepted_s = np.array(found["peaklist"])[np.array(found["binary_peaklist"], bool)] / RATE_HZ
    peaks_s = np.array([seconds(beat.peak_ns) for beat in beats])
    within_s = accepted_s[(accepted_s > FOUND_FROM_S + 1) & (accepted_s < peaks_s[-1])]
    shared = sum(np.abs(peaks_s - at_s).min() < NEAR_S for at_s in within_s)
    others = sum(np.abs(accepted_s - at_s).min() >= NEAR_S for at_s in peaks_s)
    return name, f"{shared} of {len(within_s)}", f"{others} of {len(peaks_s)}"


# Seconds after the artefact between which errors are averaged, and samples ahead.
AFTER_S, AHEAD = (0, 1, 2, 4, 8, 16), 100


def after_artefact_rows(name: str) -> list[tuple[str, ...]]:
    """Return the error 100 ms ahead in % of the pulse's height, after what a moving hand does."""
    pulse = draw(name).force_n
    height_n = float(np.ptp(pulse))

    def row(label: str, force_n: Floats) -> tuple[str, ...]:
        errors = prediction_errors_n(Ensemble("stack"), force_n, pulse, AHEAD) / height_n
        ends = [round((MOVED_FROM_S + MOVED_S + at_s) * RATE_HZ) // BATCH for at_s in AFTER_S]
        parts = [errors[first:last] for first, last in itertools.pairwise(ends)]
        return (label, *(f"{100 * np.sqrt(np.mean(part**2)):.1f}" for part in parts))

    disturbed = moved(noisy(pulse))
    with patch.object(ArtefactDetector, "observe"):
        learnt = row(f"{name}, learnt from", disturbed)
    return [
        row(f"{name}, undisturbed", noisy(pulse)),
        learnt,
        row(f"{name}, found (shipped)", disturbed),
    ]


def main(benchmark: Benchmark) -> None:
    """Run the benchmark."""
    names = list(itertools.product(("regular", "ectopic", "fibrillation"), ("wide", "paper")))
    drawn = [drawn_row(*each) for each in names]
    header = ("pulse", "found", "onset, ms", "peak, ms", "notch, ms", "good")
    benchmark.table("drawn pulses, 1 % noise: RMS / greatest error", header, drawn)
    libraries = ("pulse", "here", "heartpy", "neurokit2")
    benchmark.table(
        "peaks of drawn pulses within 60 ms", libraries, [peaks_row(*each) for each in names]
    )
    recorded = [recorded_row(name, each) for name, each in recorded_pulses(60.0).items()]
    columns = ("recording", "of heartpy's beats", "good beats that heartpy lacks or rejects")
    benchmark.table("recordings", columns, recorded)
    sent = frames(moved(noisy(draw().force_n)))
    began_s = time.process_time()
    beats = analysed(sent)
    taken_s = time.process_time() - began_s
    bad = [b for b in beats if b not in good(beats)]
    measured = [
        (
            "of a hand that moves from 15 to 19 s",
            f"{seconds(bad[0].onset_ns):.1f} to {seconds(bad[-1].onset_ns):.1f} s",
        ),
        ("processor time, ms a second of samples", f"{1e3 * taken_s / SECONDS:.2f}"),
    ]
    benchmark.table("doubtful beats, and cost", ("", ""), measured)
    after = [row for name in ("regular", "fibrillation") for row in after_artefact_rows(name)]
    times = [f"{first} to {last} s" for first, last in itertools.pairwise(AFTER_S)]
    benchmark.table(
        "error 100 ms ahead after an artefact, % of the height", ("pulse", *times), after
    )
