"""Transit times are learnt, and R waves that pulses do not follow are found out."""

from collections.abc import Iterable

import numpy as np
import pytest

from display_node.prediction.transit import FAR, TransitTime

BEAT = 160.0
RNG = np.random.default_rng(1)


def feed(
    transit: TransitTime, waves: Iterable[float], arrivals: Iterable[float], until: int
) -> list[float]:
    """Give R waves, 9 steps late, and arrivals in order; return the steps that were reliable."""
    events = [(at + 9, at, True) for at in waves] + [(at, at, False) for at in arrivals]
    events.sort(reverse=True)
    reliable = []
    for step in range(until):
        while events and events[-1][0] <= step:
            due, at, announces = events.pop()
            if announces:
                transit.announce(at, due)
            else:
                transit.arrive(at)
        transit.advance(step)
        if transit.reliable:
            reliable.append(step)
    return reliable


BEATS = np.arange(1.0, 60.0) * BEAT


@pytest.mark.parametrize(("jitter", "median"), [(0.0, 40.0), (1.0, 45.5), (4.0, 40.0)])
def test_a_transit_time_and_its_deviation_are_learnt(jitter: float, median: float) -> None:
    transit = TransitTime()
    arrivals = BEATS + median + jitter * RNG.standard_normal(len(BEATS))
    reliable = feed(transit, BEATS, arrivals, 9_500)
    assert transit.median == pytest.approx(median, abs=1.5 * jitter + 1e-9)
    assert transit.deviation == pytest.approx(max(jitter, 0.2), rel=0.7)
    assert 4 * BEAT < reliable[0] < 12 * BEAT
    assert len(reliable) > 0.8 * (9_500 - reliable[0])


def test_no_pulse_rises_until_the_next_r_wave_can_have_one() -> None:
    """A pulse rises 50 ms before its arrival, at 40 steps; R waves are found after 9 steps."""
    transit = TransitTime()
    assert transit.pause(0.0) == (0.0, 0.0)
    feed(transit, BEATS, BEATS + 40.0, round(BEATS[-1]) + 60)
    newest, tolerance = BEATS[-1], transit.tolerance
    # The last beat has arrived: it passes for 500 ms, and no other R wave has been found yet.
    now = newest + 120.0
    assert transit.pause(now) == (newest + 140.0 - now, pytest.approx(40 - 9 - tolerance - 10))
    transit.announce(now, now + 9)
    assert transit.pause(now + 15)[1] == pytest.approx(40 - 15 - tolerance - 10)
    # A pulse that no R wave announced, as after an ECG was unplugged, ends what is certain.
    transit.arrive(now + 200)
    assert transit.pause(now + 210) == (0.0, 0.0)


def lost_after(waves: np.ndarray, arrivals: np.ndarray, since: float) -> float:
    """Return how many steps after `since` reliability is lost."""
    transit = TransitTime()
    reliable = feed(transit, waves, arrivals, 9_500)
    before = [step for step in reliable if step <= since]
    assert before[-1] > since - 2
    lost = next(step for step in range(int(since), 9_500) if step not in set(reliable))
    return lost - since


SINCE = 30 * BEAT
ARRIVALS = BEATS + 40.0
LATER = BEATS > SINCE


@pytest.mark.parametrize(
    "waves",
    [
        BEATS[~LATER],
        np.concatenate([BEATS[~LATER], SINCE + 37 + 131 * np.arange(30.0)]),
        np.where(LATER, BEATS + 60, BEATS),
        np.where(LATER, BEATS - 20, BEATS),
        np.concatenate([BEATS[~LATER], SINCE + np.cumsum(RNG.uniform(60, 200, 30))]),
    ],
    ids=["unplugged", "another heart", "late", "jump", "noise"],
)
def test_wrong_r_waves_are_found_out_within_3_s(waves: np.ndarray) -> None:
    assert lost_after(np.sort(waves), ARRIVALS, SINCE) < 600


def test_a_pulse_that_pauses_is_found_out_too() -> None:
    assert lost_after(BEATS, ARRIVALS[~LATER], SINCE + BEAT) < 600


def test_a_constant_jump_is_learnt_as_another_transit_time() -> None:
    transit = TransitTime()
    feed(transit, np.where(LATER, BEATS - 20, BEATS), ARRIVALS, 9_500)
    assert transit.reliable
    assert transit.median == pytest.approx(60.0)
    lags = transit.analogues.lags
    assert 0 < lags.max() < (60 - 30) * BEAT


def test_one_wrong_beat_ends_nothing() -> None:
    transit = TransitTime()
    arrivals = np.delete(ARRIVALS, 40)
    reliable = feed(transit, BEATS, arrivals, 9_500)
    assert set(range(20 * int(BEAT), 9_400)) <= set(reliable)


def test_analogues_are_the_confirmed_beats_with_the_time_to_the_next_r_wave() -> None:
    transit = TransitTime()
    arrivals = ARRIVALS.copy()
    arrivals[20] += FAR + 1
    feed(transit, BEATS, arrivals, 9_500)
    newest, lags, lengths, _ = transit.analogues
    assert newest == BEATS[-1]
    assert newest - BEATS[20] not in lags
    assert newest - BEATS[21] in lags
    np.testing.assert_allclose(lengths, BEAT + 9)


def test_analogues_have_the_two_r_r_intervals_before_them_from_those_of_the_newest() -> None:
    intervals = BEAT * np.array([1.0, 0.8, 1.1, 0.7, 1.2, 0.9, 1.0, 6.0, 1.0, 0.8] + [1.0] * 10)
    waves = 400 + np.cumsum(intervals)
    transit = TransitTime()
    feed(transit, waves, waves + 40, 5_500)
    found = dict(zip(transit.analogues.lags.tolist(), transit.analogues.intervals, strict=True))
    newest = waves[-1]
    for place in (4, 5, 6):
        before = intervals[[place, place - 1]] - BEAT
        np.testing.assert_allclose(found[round(newest - waves[place])], before, atol=1e-9)
    # A missed R wave, or a pause of the ECG, is no longer interval than 2 s.
    np.testing.assert_allclose(found[round(newest - waves[7])], [400 - BEAT, 0.0], atol=1e-9)
    first = round(newest - waves[1])
    assert first not in found


def test_beats_of_another_heart_in_tolerance_for_a_while_do_not_bring_it_back() -> None:
    """They drift by a third of the tolerance a beat, so that five in a row are within it."""
    transit = TransitTime()
    waves = np.concatenate([BEATS[~LATER], SINCE + np.cumsum(np.full(28, BEAT - 4.0))])
    reliable = feed(transit, waves, ARRIVALS, 9_500)
    assert not [step for step in reliable if step > SINCE + 600]
