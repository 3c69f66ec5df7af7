import math

import numpy as np
import pytest
from numpy.typing import NDArray

from display_node.control.feed_forward import Gap, ScrewPath
from display_node.plant.scene import StepperScene
from display_node.plant.stepper import Backlash, Rotor
from protocol.tactile import ElasticLayer

Positions = NDArray[np.float64]
BACKLASH_M = 10e-6
LEAST_TURN_M = BACKLASH_M / 4
ROTOR = {"rotor_resonance": "100 Hz"}
BACKLASH = {"backlash": "10 µm"}


def scene(**table: object) -> StepperScene:
    return StepperScene.model_validate({"kind": "stepper"} | table)


class Bench:
    """A screw path, with a rotor and a backlash that agree with its model."""

    def __init__(self, tick_s: float = 1e-3, /, **table: object) -> None:
        self.scene = scene(**table)
        self.law = self.scene.contact(ElasticLayer())
        self.path = ScrewPath(self.scene, self.law, tick_s)
        self.tick_s = tick_s
        self.foreseen_m: list[float] = []

    def reference_n(self, tip_m: Positions) -> list[float]:
        return [self.law.force(position_m) for position_m in tip_m.tolist()]

    def leading(self, tip_m: Positions) -> Positions:
        """Return the path earlier by the lead."""
        at = np.arange(len(tip_m))
        return np.interp(at + self.path.shaper_delay_s / self.tick_s, at, tip_m)

    def run(self, tip_m: Positions) -> tuple[Positions, Positions, Positions]:
        """Return screw, wanted tip and moved tip at each tick's end."""
        backlash, rotor = Backlash(self.scene.backlash_m), None
        if self.scene.rotor_resonance_hz is not None:
            rotor = Rotor(self.scene.rotor_resonance_hz, self.scene.rotor_damping, self.tick_s)
        rows, before_m = [], 0.0
        reference_n, horizon = self.reference_n(self.leading(tip_m)), self.path.horizon
        for tick in range(len(tip_m) - horizon):
            self.path.advance(reference_n[tick : tick + horizon + 1])
            at_m = self.path.screw_m
            driving_m = at_m if rotor is None else rotor.step(before_m, at_m)
            before_m = at_m
            rows.append((at_m, tip_m[tick + 1], backlash.step(driving_m)))
            self.foreseen_m.append(self.path.tip_m)
        screw_m, wanted_m, moved_m = np.array(rows).T
        return screw_m, wanted_m, moved_m


def swell_m(tick_s: float = 1e-3, rate_hz: float = 2.0, duration_s: float = 2.0) -> Positions:
    """Return a path from first touch to 0.3 mm and back, `rate_hz` times a second."""
    t_s = np.arange(round(duration_s / tick_s)) * tick_s
    swell: Positions = 0.15e-3 * (1 - np.cos(2 * math.pi * rate_hz * t_s))
    return swell


def up_and_down_m(*extremes_m: float, ticks: int = 100) -> Positions:
    """Return a straight path from each extreme to the next, with `ticks` ticks each."""
    at = np.arange(len(extremes_m)) * ticks
    return np.interp(np.arange(at[-1] + 1), at, extremes_m)


@pytest.mark.parametrize("table", [{}, ROTOR, BACKLASH, ROTOR | BACKLASH])
@pytest.mark.parametrize("first_m", [0.0, 0.2e-3])
def test_the_speeds_add_up_to_the_screws_travel(table: dict[str, object], first_m: float) -> None:
    bench = Bench(**table)
    reference_n = bench.reference_n(first_m + swell_m(rate_hz=5))
    travel_m = [0.0]
    screw_m = []
    for tick in range(len(reference_n) - bench.path.horizon):
        speed = bench.path.advance(reference_n[tick : tick + bench.path.horizon + 1])
        travel_m.append(travel_m[-1] + speed * bench.tick_s)
        screw_m.append(bench.path.screw_m)
    # The path starts at the first reference, on the flank that presses.
    start_m = first_m + bench.scene.backlash_m / 2
    assert screw_m[0] - travel_m[1] == pytest.approx(start_m, abs=2e-6 if table else 1e-12)
    travelled_m = np.array(travel_m[1:]) - travel_m[1]
    assert travelled_m == pytest.approx(np.array(screw_m) - screw_m[0], abs=1e-12)


@pytest.mark.parametrize("damping", [0.2, 0.5, 1.5])
def test_the_rotors_inverse_is_undone_by_the_rotor(damping: float) -> None:
    errors_m = []
    for tick_s in (1e-3, 0.5e-3):
        bench = Bench(tick_s, rotor_damping=damping, **ROTOR)
        assert bench.path.shaped == (bench.path.shaper_delay_s > 0) == (damping < 1)
        # Squared, since the path of a rotor at rest must begin without acceleration.
        tip_m = swell_m(tick_s, rate_hz=5.0) ** 2 / 0.3e-3
        screw_m, wanted_m, moved_m = bench.run(tip_m)
        assert np.abs(screw_m - wanted_m).max() > 0.5e-6
        # Without the lead's end.
        ends = round(20e-3 / tick_s)
        errors_m.append(np.abs(moved_m - wanted_m)[:-ends].max())
    if damping < 1:
        # A shaper leaves the third order, 0.1 % of 0.3 mm at 5 Hz.
        assert max(errors_m) < 0.3e-6
    else:
        # The error is below 30 nm of 0.3 mm at 5 Hz, and a quarter of it at half the tick.
        assert errors_m[0] < 30e-9
        assert errors_m[1] < 0.26 * errors_m[0]


@pytest.mark.parametrize("table", [{}, BACKLASH])
def test_a_shaped_path_foresees_the_tip(table: dict[str, object]) -> None:
    bench = Bench(**ROTOR, **table)
    _, wanted_m, moved_m = bench.run(swell_m(rate_hz=5.0))
    foreseen_m = bench.foreseen_m
    # The path starts at rest on the flank that presses, the rotor of this bench at 0.
    assert foreseen_m[100:] == pytest.approx(moved_m[100:], abs=1e-9)
    assert foreseen_m[100:-20] == pytest.approx(wanted_m[100:-20], abs=6e-6)


def test_the_screw_is_on_the_flank_that_drives() -> None:
    screw_m, wanted_m, moved_m = Bench(**BACKLASH).run(swell_m())
    ahead_m = screw_m - wanted_m
    rising = np.gradient(wanted_m) > 0
    # Further from the turns than a quarter of the backlash, the least turn, and two ticks.
    clear = np.minimum(wanted_m, 0.3e-3 - wanted_m) > LEAST_TURN_M + 1.5e-6
    assert clear.mean() > 0.7
    assert ahead_m[clear & rising] == pytest.approx(BACKLASH_M / 2, abs=1e-12)
    assert ahead_m[clear & ~rising] == pytest.approx(-BACKLASH_M / 2, abs=1e-12)
    assert moved_m[clear] == pytest.approx(wanted_m[clear], abs=1e-12)
    # At a turn, the tip is off by at most the least turn and the travel of a tick.
    off_m = np.abs(moved_m - wanted_m).max()
    assert 0 < off_m <= LEAST_TURN_M + np.abs(np.diff(wanted_m)).max()


@pytest.mark.parametrize("table", [BACKLASH, ROTOR | BACKLASH])
@pytest.mark.parametrize(("share", "crossed"), [(0.9, False), (1.3, True)])
def test_only_a_turn_of_a_quarter_of_the_backlash_is_crossed(
    table: dict[str, object], share: float, crossed: bool
) -> None:
    top_m, turn_m = 50e-6, share * LEAST_TURN_M
    tip_m = up_and_down_m(0, top_m, top_m - turn_m, 2 * top_m)
    bench = Bench(**table)
    screw_m, wanted_m, _ = bench.run(tip_m)
    # Where a leg begins or ends, the rotor's inverse moves the screw further than the flank does.
    behind = screw_m - wanted_m < 0
    assert behind[110:].any() == crossed
    assert not behind[:90].any()


def test_small_turns_do_not_add_up() -> None:
    extremes_m = [50e-6, 50e-6 - 0.9 * LEAST_TURN_M] * 6
    screw_m, wanted_m, _ = Bench(**BACKLASH).run(up_and_down_m(0, *extremes_m, ticks=20))
    assert screw_m - wanted_m == pytest.approx(BACKLASH_M / 2, abs=1e-12)


def test_a_slow_descent_is_one_turn() -> None:
    screw_m, wanted_m, _ = Bench(**BACKLASH).run(up_and_down_m(0, 50e-6, 40e-6, ticks=2000))
    changes = np.flatnonzero(np.abs(np.diff(screw_m - wanted_m)) > 1e-12)
    assert len(changes) == 1
    fallen_m = 50e-6 - wanted_m[changes[0] + 1]
    assert fallen_m == pytest.approx(LEAST_TURN_M, rel=0.02)


def test_the_gap_is_crossed_at_once() -> None:
    gap = Gap(BACKLASH_M)
    tip_m = up_and_down_m(0, 0.5e-3, 0).tolist()
    offsets_m = np.array([gap.cross(tip_m[k : k + 2]) for k in range(len(tip_m) - 2)])
    # The tip is at its highest at tick 100.
    assert np.flatnonzero(np.diff(offsets_m)).tolist() == [99]
    assert offsets_m[[0, -1]] == pytest.approx([BACKLASH_M / 2, -BACKLASH_M / 2])


def test_after_missed_ticks_a_shaped_path_is_that_of_the_time() -> None:
    late, prompt = Bench(**ROTOR), Bench(**ROTOR)
    reference_n = prompt.reference_n(up_and_down_m(0, 3e-3))
    for tick in range(60):
        prompt.path.advance(reference_n[tick : tick + 3])
        if tick <= 40:
            late.path.advance(reference_n[tick : tick + 3])
    late.path.advance(reference_n[59:62], ticks=19)
    assert late.path.screw_m == pytest.approx(prompt.path.screw_m, abs=2e-6)


@pytest.mark.parametrize("share", [0.2, 1.0])
def test_a_shaped_path_is_bounded_in_speed_and_place(share: float) -> None:
    bench = Bench(**ROTOR, **BACKLASH)
    jumps_n = ([0.0] * 30 + [2.0] * 30) * 5
    screws_m = []
    for tick in range(len(jumps_n) - 2):
        bench.path.advance(
            jumps_n[tick : tick + 3], fastest_m_per_s=0.05 * share, furthest_m=0.5e-3
        )
        screws_m.append(bench.path.screw_m)
    assert np.abs(np.diff(screws_m)).max() <= 0.05e-3 * share + 1e-12
    assert max(screws_m) <= 0.5e-3 + BACKLASH_M / 2
    assert min(screws_m) >= -BACKLASH_M / 2


def test_travel_in_missed_ticks_counts_and_is_corrected() -> None:
    bench = Bench()
    path = bench.path
    reference_n = bench.reference_n(np.append(up_and_down_m(0, 50e-6), 50e-6))
    # Before the first tick there is no travel.
    path.shift(0.1e-3)
    speeds = [path.advance(reference_n[tick : tick + 2]) for tick in range(20)]
    assert speeds[0] == Bench().path.advance(reference_n[:2])
    # On a straight path, seven ticks at its speed need no correction.
    path.shift(7 * speeds[-1] * 1e-3)
    assert path.advance(reference_n[27:29]) == pytest.approx(speeds[-1], rel=1e-6)
    for tick in range(28, 100):
        speed = path.advance(reference_n[tick : tick + 2])
    path.shift(5 * speed * 1e-3)
    assert path.advance(reference_n[100:102]) == pytest.approx(-5 * speed, rel=1e-6)
