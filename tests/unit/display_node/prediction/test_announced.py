"""R waves change what is predicted only where they announce beats.

How much they lower the error, and how soon a wrong ECG is found out: tests/system/accuracy.
"""

from display_node.prediction.ensemble import Ensemble
from tests.support.announced_pulses import (
    announce,
    announced_pulses,
    nrmse,
    run,
)
from tests.support.drawn_pulses import (
    FRAME,
    HORIZONS_MS,
    Beats,
    Pulse,
    drawn,
    drawn_beats,
    instant_ns,
    observe_frame,
)

PAUSED_S = 22.0
AT_100_MS = HORIZONS_MS.index(100)


def test_without_r_waves_the_results_are_the_same_to_the_last_bit() -> None:
    pulse = announced_pulses(22.0, 1, 0.005)[-1].pulse.sensed[:8_000]
    plain, asked = Ensemble("stack"), Ensemble("stack")
    paths = []
    for stack in (plain, asked):
        found = []
        for frame in range(len(pulse) // FRAME):
            observe_frame(stack, pulse, frame)
            if stack is asked:
                stack.announce([])
            for _ in range(FRAME):
                stack.work()
            found.append(stack.predict(instant_ns(frame * FRAME + 100)))
        paths.append(found)
    assert paths[0] == paths[1]
    assert plain.transit is None


def test_no_beat_is_predicted_in_a_pause_longer_than_any_before() -> None:
    """As long as no R wave has come, no beat is near, though no analogue lasted as long."""
    varying = drawn_beats(PAUSED_S, 1)["variability"]
    intervals_s = varying.intervals_s.copy()
    place = int(varying.onsets_s.searchsorted(18.0))
    intervals_s[place] = 1.8 * intervals_s.mean()
    beats = Beats(intervals_s, varying.amplitudes)
    pulse = drawn(beats, "wide", PAUSED_S, 0.8, predictive_shape=False)
    pulse = (pulse - pulse.mean()) / pulse.std()
    announced = announce(Pulse("pause", pulse, pulse), beats, 0.005, 1)
    found = {with_ecg: run(announced, with_ecg) for with_ecg in (False, True)}
    # From where the next beat would be until the next R wave is found.
    usual_s = beats.onsets_s[place] + 0.8
    errors = {each: nrmse(found[each].squares, usual_s, usual_s + 0.45) for each in found}
    assert errors[True][AT_100_MS] < 0.6 * errors[False][AT_100_MS]
