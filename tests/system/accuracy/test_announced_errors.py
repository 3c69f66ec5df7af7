"""R waves make the next beat predictable, and wrong ones leave the prediction as it is."""

from functools import cache

import numpy as np
import pytest

from display_node.prediction.ensemble import Ensemble
from display_node.prediction.r_waves import RWaveDetector
from tests.support.announced_pulses import (
    FAULTS,
    JUMP,
    AnnouncedPulse,
    EcgFault,
    announced_pulses,
    nrmse,
    run,
    with_fault,
)
from tests.support.drawn_pulses import (
    FRAME,
    HORIZONS_MS,
    Floats,
    observe_frame,
)

SECONDS, MINUTE_S, FROM_S = 34.0, 60.0, 20.0
# A wrong ECG is to be unused so long after it; a relative rise that counts as none; and the share
# of the time in which a wrong ECG may be used.
FOUND_OUT_S, EQUAL, UNUSED = 3.0, 0.005, 0.05
AT_100_MS = HORIZONS_MS.index(100)


@cache
def sets(jitter_s: float, seed: int = 1, seconds: float = SECONDS) -> dict[str, AnnouncedPulse]:
    return {str(each): each for each in announced_pulses(seconds, seed, jitter_s)}


@cache
def squares_without(name: str, seed: int = 1, seconds: float = SECONDS) -> Floats:
    return run(sets(0.005, seed, seconds)[name], with_ecg=False).squares


def errors(name: str, jitter_s: float, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the errors of a minute at each horizon without and with an ECG, as in the study."""
    with_ecg = run(sets(jitter_s, seed, MINUTE_S)[name], with_ecg=True).squares
    squares = squares_without(name, seed, MINUTE_S), with_ecg
    without, announced = (np.array(nrmse(each, FROM_S)) for each in squares)
    return without, announced


@pytest.mark.parametrize(
    ("name", "seed", "bound"),
    [
        ("variability", 1, 0.12),
        ("ectopic", 5, 0.16),
        ("fibrillation", 1, 0.15),
    ],
)
def test_an_ecg_lowers_the_error_where_only_it_predicts_the_next_beat(
    name: str, seed: int, bound: float
) -> None:
    """Five seeds are printed by `make bench ARGS=announce`.

    The fifth pulse with ectopic beats has its first weak beat, and the first pause, after 27 s.
    """
    without, announced = errors(name, 0.005, seed)
    assert announced[AT_100_MS] < bound
    assert (announced < without).all()


@pytest.mark.parametrize("name", ["variability", "ectopic", "fibrillation"])
def test_a_transit_time_that_varies_by_20_ms_does_no_harm(name: str) -> None:
    without, announced = errors(name, 0.02, 1)
    assert (announced <= (1 + EQUAL) * without).all()


@pytest.mark.parametrize("fault", FAULTS, ids=[fault.name for fault in FAULTS])
def test_a_wrong_ecg_is_found_out_within_3_s_and_no_longer_used(fault: EcgFault) -> None:
    """One that has jumped is used with the new transit time, and then predicts better than none."""
    squares, used, _ = run(with_fault(sets(0.005)["variability"], fault, FROM_S), with_ecg=True)
    first = round(FROM_S * 1000) // FRAME
    assert used[first - 1]
    assert not used[first : first + 600].all()
    if fault.name != JUMP:
        assert used[first + 600 :].mean() < UNUSED
        return
    late_s = FROM_S + FOUND_OUT_S
    assert used[-200:].all()
    without = nrmse(squares_without("variability"), late_s)
    assert nrmse(squares, late_s)[AT_100_MS] < without[AT_100_MS]


def test_the_estimate_of_the_error_is_that_of_the_corrected_path() -> None:
    announced = sets(0.005)["fibrillation"]
    estimates = []
    for with_ecg in (False, True):
        result = run(announced, with_ecg)
        estimates.append(result.stack.error_n(100_000_000))
    assert estimates[1] < 0.6 * estimates[0]


def test_r_waves_in_later_data_than_the_pulse_are_used_when_the_pulse_is_as_new() -> None:
    """A burst of frames holds R waves that a prediction of its first samples must not know."""
    announced = sets(0.005)["variability"]
    stack, detector = Ensemble("stack"), RWaveDetector()
    frames = (20 * 1000) // FRAME
    for frame in range(frames):
        stack.announce(observe_frame(detector, announced.ecg_mv, frame))
    for frame in range(frames):
        observe_frame(stack, announced.pulse.sensed, frame)
        for _ in range(FRAME):
            stack.work()
    squares, _, reference = run(AnnouncedPulse(announced.pulse, announced.ecg_mv), with_ecg=True)
    assert len(squares) > frames
    assert stack.transit is not None
    assert reference.transit is not None
    shared = list(stack.transit.waves)[:20]
    for mine, theirs in zip(shared, reference.transit.waves, strict=False):
        assert (mine.at, mine.found) == (theirs.at, theirs.found)
