"""Disturbances under "auto": E goes back soon after them, and no jump is felt.

A calm pulse over a link of 40 ms; an artefact, an early beat, a burst of loss or a finger that is
lifted after 25 s of it.
"""

from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest

from protocol.tactile import JND
from protocol.ticks import TickState
from telepulse.simulation.virtual_time import Simulation
from tests.support.drawn_pulses import Beats, Floats, drawn, make_rhythm
from tests.system.accuracy.test_perceived_delay import MS, STREAM_BEGINS_S, WAN, scene

SECONDS, DISTURBED_S = 36.0, 25.0
HEIGHT_N, PRELOAD_N = 0.3, 0.3
BACK_WITHIN_S = 5.0


def pulse_n(early_beat: bool = False) -> Floats:
    rng = np.random.default_rng(2)
    beats = make_rhythm(rng, SECONDS, 0.02, lambda _: 75.0)
    if early_beat:
        intervals_s, amplitudes = beats.intervals_s.copy(), beats.amplitudes.copy()
        early = int(np.searchsorted(beats.onsets_s, DISTURBED_S))
        intervals_s[early - 1] *= 0.6
        intervals_s[early] *= 1.4
        amplitudes[early] *= 0.6
        beats = Beats(intervals_s, amplitudes)
    unit = drawn(beats, "wide", SECONDS, 0.8)
    noise_n = 5e-4 * rng.standard_normal(len(unit))
    return np.asarray(PRELOAD_N + HEIGHT_N * unit / np.ptp(unit) + noise_n)


def touched_n() -> Floats:
    """Return a pulse whose sensor is touched for 2 s, with several times its height."""
    disturbed_n, first = pulse_n(), round(1_000 * DISTURBED_S)
    levels_n = np.random.default_rng(9).uniform(0.6, 1.5, 10)
    disturbed_n[first : first + 2_000] += np.repeat(levels_n, 200)
    return disturbed_n


def lifted_n() -> Floats:
    """Return a pulse from which the finger is lifted for 4 s."""
    disturbed_n, first = pulse_n(), round(1_000 * DISTURBED_S)
    disturbed_n[first : first + 4_000] = 0.0
    return disturbed_n


class Disturbance(NamedTuple):
    """A pulse and a link; ends_s: when the disturbance is over; rises: whether E has to rise."""

    make_n: Callable[[], Floats]
    ends_s: float
    link: str = WAN
    rises: bool = True


DISTURBANCES = {
    "touched": Disturbance(touched_n, DISTURBED_S + 2.0),
    "early beat": Disturbance(lambda: pulse_n(early_beat=True), DISTURBED_S + 1.5, rises=False),
    "loss": Disturbance(pulse_n, DISTURBED_S + 0.9, WAN + ",cut.from=25.5s,cut.for=400ms", False),
    "lifted": Disturbance(lifted_n, DISTURBED_S + 4.0),
}


@pytest.mark.parametrize("name", DISTURBANCES)
def test_e_is_back_within_5_s_after_a_disturbance_and_no_jump_is_felt(
    name: str, tmp_path: Path
) -> None:
    case = DISTURBANCES[name]
    sensed_n = case.make_n()
    ticks: list[tuple[float, float, float]] = []

    def watch(tick: TickState) -> None:
        felt_s = tick.now_ns * 1e-9 - STREAM_BEGINS_S
        ticks.append((felt_s, tick.playout_delay_ns / MS, tick.felt_n))

    played = scene(case.link, "stack", pulse_n=sensed_n, folder=tmp_path)
    Simulation(played, seed=1).run(SECONDS - 0.5, watch=watch)
    at_s, delay_ms, felt_n = np.array(ticks).T
    usual_ms = delay_ms[(at_s > DISTURBED_S - 3) & (at_s < DISTURBED_S)].max()
    during = (at_s > DISTURBED_S) & (at_s < case.ends_s + BACK_WITHIN_S)
    assert delay_ms[at_s > case.ends_s + BACK_WITHIN_S].max() <= usual_ms + 5
    if case.rises:
        assert delay_ms[during].max() > usual_ms + 20
    # Ticks at full strength that follow one another; what was sensed may jump itself.
    steps_n = np.abs(np.diff(felt_n))[np.diff(at_s) < 1.5e-3]
    own_n = np.abs(np.diff(sensed_n)).max()
    assert steps_n.max() < max(JND * HEIGHT_N, own_n)
