"""Slew and force of the scenes of a bench, with forces that jump, swing and end."""

import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from display_node.control import feed_forward
from display_node.control.force_bounds import ForceBounds
from display_node.control.link_loss import Fade
from display_node.plant.scene import StepperScene
from tests.support.scene_loops import (
    felt_under,
    jumping_n,
    other_rotors,
    slews_n_per_s,
    swinging_n,
)
from tests.support.sender import display_scene

# For one microstep, and the loop's correction.
MARGIN = 1.02


@pytest.mark.parametrize("name", ["radial", "tmcl_bench", "real_bench"])
def test_forces_that_jump_are_felt_within_the_slew_limit_up_and_down(name: str) -> None:
    scene, tick_s = display_scene(name), display_scene(name).tick_ns * 1e-9
    limit_n_per_s = scene.safety.slew_limit_n_per_s
    for slew_n_per_s in slews_n_per_s(felt_under(scene, jumping_n(100, tick_s)), tick_s):
        assert 0.9 * limit_n_per_s < slew_n_per_s <= MARGIN * limit_n_per_s


# Some pieces of a force: jumps, swings at any rate and noise, each for some ticks.
FORCES_N = st.sampled_from([0.0, 0.3, 1.0, 2.5, 1e30, -1e30, math.nan])
PIECES = st.one_of(
    st.builds(lambda n, ticks: [n] * ticks, FORCES_N, st.integers(1, 200)),
    st.builds(
        lambda low_n, high_n, ticks, rounds: ([low_n] * ticks + [high_n] * ticks) * rounds,
        *(FORCES_N, FORCES_N, st.integers(1, 12), st.integers(1, 15)),
    ),
    st.lists(st.floats(-1, 4), min_size=1, max_size=60),
)


@settings(max_examples=20, deadline=None)
@given(st.lists(PIECES, min_size=1, max_size=30), st.integers(0, 6), st.booleans())
def test_no_force_makes_the_rotor_ring_beyond_the_slew_limit(
    pieces: list[list[float]], rotor: int, learnt: bool
) -> None:
    scene = display_scene("real_bench")
    assert isinstance(scene.actuator, StepperScene)
    actual = [scene.actuator, *other_rotors(scene.actuator)][rotor]
    first_n = list(jumping_n(20, 1e-3)) if learnt else [0.0]
    requested_n = [*first_n, *(force_n for piece in pieces for force_n in piece)]
    felt_n = felt_under(scene, requested_n, actual)[len(first_n) - 1 :]
    # A rotor that differs by 20 % misleads the observer while it learns the finger.
    margin = 1.15 if rotor and not learnt else 1.05
    limit_n_per_s = scene.safety.slew_limit_n_per_s
    assert max(slews_n_per_s(felt_n, 1e-3)) <= margin * limit_n_per_s
    assert felt_n.max() <= 1.01 * scene.safety.force_limit_n


# Periods of the rotor's resonance at its model, and 20 % below and above it.
@pytest.mark.parametrize("period_ticks", [8, 10, 12])
def test_a_force_that_swings_at_the_resonance_is_felt_within_the_slew_limit(
    period_ticks: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    scene, bound_n_per_s = display_scene("real_bench"), 52.5
    assert isinstance(scene.actuator, StepperScene)
    rotors = [scene.actuator, *other_rotors(scene.actuator)]

    def greatest_slew_n_per_s() -> float:
        felt_n = [felt_under(scene, swinging_n(period_ticks, 600), rotor) for rotor in rotors]
        return max(slew for each_n in felt_n for slew in slews_n_per_s(each_n, 1e-3))

    assert greatest_slew_n_per_s() <= bound_n_per_s
    monkeypatch.setattr(feed_forward, "rotor_rings", lambda *_: False)
    assert greatest_slew_n_per_s() > 1.25 * bound_n_per_s


def test_a_stale_stream_leaves_no_force_of_a_shaped_path_after_100_ms() -> None:
    scene = display_scene("real_bench")
    loop, fade = scene.force_loop(), Fade(scene.safety, scene.tick_ns)
    bounds = ForceBounds(scene.safety, scene.tick_ns)
    for tick in range(1100):
        bounded_n = bounds.bound([2.5] * (loop.horizon + 1), fade.advance(alive=tick < 1000))
        loop.tick(bounded_n, loop.read_film())
        if tick == 999:
            assert loop.felt_n > 2.4
    assert loop.felt_n < 0.02
