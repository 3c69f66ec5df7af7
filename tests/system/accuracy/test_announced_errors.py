"""R waves make the next beat predictable, and wrong ones leave the prediction as it is."""

from functools import cache

import numpy as np
import pytest

from display_node.prediction.ensemble import Ensemble
from display_node.prediction.r_waves import RWaveDetector
from telepulse.reports.studies.announce_pulses import (
    FAULTS,
    AnnouncedPulse,
    EcgFault,
    announced_pulses,
    with_fault,
)
from telepulse.reports.studies.announce_study import nrmse, run, score_fault
from telepulse.reports.studies.prediction_study import (
    FRAME,
    HORIZONS_MS,
    TICK_NS,
    observe_frame,
)

SECONDS, FROM_S = 34.0, 20.0
AT_100_MS = HORIZONS_MS.index(100)


@cache
def sets(jitter_s: float) -> dict[str, AnnouncedPulse]:
    return {str(each): each for each in announced_pulses(SECONDS, 1, jitter_s)}


@cache
def without(name: str) -> tuple[float, ...]:
    return nrmse(run(sets(0.005)[name], with_ecg=False).squares, FROM_S)


@pytest.mark.parametrize(
    ("name", "bound"), [("variability", 0.12), ("ectopic", 0.16), ("fibrillation", 0.2)]
)
def test_an_ecg_lowers_the_error_where_only_it_predicts_the_next_beat(
    name: str, bound: float
) -> None:
    """The bounds over a minute are printed by `telepulse study announce`; here fewer are learnt."""
    announced = nrmse(run(sets(0.005)[name], with_ecg=True).squares, FROM_S)
    assert announced[AT_100_MS] < bound
    assert (np.array(announced) < np.array(without(name))).all()


@pytest.mark.parametrize("fault", FAULTS, ids=[fault.name for fault in FAULTS])
def test_a_wrong_ecg_is_found_out_within_3_s_and_no_longer_used(fault: EcgFault) -> None:
    announced = with_fault(sets(0.005)["variability"], fault, FROM_S)
    _, used, _ = run(announced, with_ecg=True)
    first = round(FROM_S * 1000) // FRAME
    assert used[first - 1]
    assert not used[first : first + 600].all()
    if fault.name != "jumps 0.1 s":
        assert used[first + 600 :].mean() < 0.2


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
    stack, detector = Ensemble("stack", TICK_NS), RWaveDetector()
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


def test_a_fault_that_is_never_found_out_takes_forever() -> None:
    whole = announced_pulses(30.0, 1, 0.0)[0]
    number = next(n for n, fault in enumerate(FAULTS) if fault.name == "unplugged")
    assert score_fault((whole, number)).seconds < 3
    regular = AnnouncedPulse(whole.pulse, np.zeros_like(whole.ecg_mv))
    assert score_fault((regular, number)).seconds == 0
