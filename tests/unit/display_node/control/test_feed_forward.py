import math
from itertools import pairwise

import numpy as np
import pytest
from numpy.typing import NDArray

from display_node.control.feed_forward import Gap, ScrewPath
from display_node.plant.stepper import Backlash, Rotor, StepperScene
from protocol.tactile import ElasticLayer

Positions = NDArray[np.float64]
BACKLASH_M = 10e-6
LEAST_TURN_M = BACKLASH_M / 4
ROTOR = {"rotor_resonance": "100 Hz"}
BACKLASH = {"backlash": "10 µm"}


def scene(**table: object) -> StepperScene:
    return StepperScene.model_validate({"kind": "stepper"} | table)


class Bench:
    """Runs the path of a tip on a rotor and backlash that are just as the path takes them for."""

    def __init__(self, tick_s: float = 1e-3, /, **table: object) -> None:
        self.scene = scene(**table)
        self.law = self.scene.contact(ElasticLayer())
        self.path = ScrewPath(self.scene, self.law, tick_s)
        self.tick_s = tick_s

    def reference_n(self, tip_m: Positions) -> list[float]:
        return [self.law.force(position_m) for position_m in tip_m.tolist()]

    def run(self, tip_m: Positions) -> tuple[Positions, Positions, Positions]:
        """Screw, wanted tip and moved tip at each tick's end."""
        named = self.scene
        turned = Backlash(named.backlash_m)
        rotor = None
        if named.rotor_resonance_hz is not None:
            rotor = Rotor(named.rotor_resonance_hz, named.rotor_damping, self.tick_s)
        screw_m, wanted_m, moved_m = [], [], []
        before_m = 0.0
        reference_n, horizon = self.reference_n(tip_m), self.path.horizon
        for tick in range(len(tip_m) - horizon):
            self.path.advance(reference_n[tick : tick + horizon + 1])
            at_m = self.path.screw_m
            driving_m = at_m if rotor is None else rotor.step(before_m, at_m)
            before_m = at_m
            screw_m.append(at_m)
            wanted_m.append(self.path.tip_m)
            moved_m.append(turned.step(driving_m))
        return np.array(screw_m), np.array(wanted_m), np.array(moved_m)


def swell_m(tick_s: float = 1e-3, rate_hz: float = 2.0, duration_s: float = 2.0) -> Positions:
    """A path from first touch to 0.3 mm and back, as often as rate_hz says."""
    t_s = np.arange(round(duration_s / tick_s)) * tick_s
    swell: Positions = 0.15e-3 * (1 - np.cos(2 * math.pi * rate_hz * t_s))
    return swell


def up_and_down_m(*extremes_m: float, ticks: int = 100) -> Positions:
    """Straight from one extreme to the next, 100 ticks each."""
    legs = [
        np.linspace(start_m, end_m, ticks, endpoint=False)
        for start_m, end_m in pairwise(extremes_m)
    ]
    return np.concatenate([*legs, [extremes_m[-1]]])


@pytest.mark.parametrize(
    ("table", "horizon"),
    [
        ({}, 1),
        (ROTOR, 2),
        (BACKLASH, 2),
        (ROTOR | BACKLASH, 3),
        (ROTOR | BACKLASH | {"rotor_damping": 1.0}, 2),
        # Half a period of this rotor is over within a tick.
        (BACKLASH | {"rotor_resonance": "900 Hz"}, 2),
    ],
)
def test_the_horizon_is_what_the_actuator_needs(table: dict[str, object], horizon: int) -> None:
    bench = Bench(**table)
    assert bench.path.horizon == horizon
    reference_n = bench.reference_n(swell_m(duration_s=0.1))
    bench.path.advance(reference_n[: horizon + 1])
    with pytest.raises(IndexError):
        Bench(**table).path.advance(reference_n[:1])


def test_without_rotor_and_play_the_screw_is_the_tip() -> None:
    screw_m, wanted_m, moved_m = Bench().run(swell_m())
    assert wanted_m == pytest.approx(swell_m()[1:], rel=1e-9, abs=1e-15)
    assert screw_m.tolist() == moved_m.tolist() == wanted_m.tolist()


@pytest.mark.parametrize("table", [{}, ROTOR, BACKLASH, ROTOR | BACKLASH])
@pytest.mark.parametrize("first_m", [0.0, 0.2e-3])
def test_all_speeds_together_are_the_screws_way(table: dict[str, object], first_m: float) -> None:
    bench = Bench(**table)
    reference_n = bench.reference_n(first_m + swell_m(rate_hz=5))
    travel_m = [0.0]
    screw_m = []
    for tick in range(len(reference_n) - bench.path.horizon):
        speed = bench.path.advance(reference_n[tick : tick + bench.path.horizon + 1])
        travel_m.append(travel_m[-1] + speed * bench.tick_s)
        screw_m.append(bench.path.screw_m)
    # It takes the first reference for where it stands, on the flank that presses.
    start_m = first_m + bench.scene.backlash_m / 2
    assert screw_m[0] - travel_m[1] == pytest.approx(start_m, abs=2e-6 if table else 1e-12)
    ways = np.array(travel_m[1:]) - travel_m[1]
    assert ways == pytest.approx(np.array(screw_m) - screw_m[0], abs=1e-12)


@pytest.mark.parametrize("damping", [0.0, 0.2, 1.5])
def test_the_rotors_inverse_is_undone_by_the_rotor(damping: float) -> None:
    errors_m = []
    for tick_s in (1e-3, 0.5e-3):
        bench = Bench(tick_s, rotor_damping=damping, **ROTOR)
        # Squared, as the path of a rotor at rest must begin without an acceleration.
        tip_m = swell_m(tick_s, rate_hz=5.0) ** 2 / 0.3e-3
        screw_m, wanted_m, moved_m = bench.run(tip_m)
        assert np.abs(screw_m - wanted_m).max() > 0.5e-6
        errors_m.append(np.abs(moved_m - wanted_m).max())
    # Of 0.3 mm at 5 Hz a tick of 1 ms leaves less than 30 nm, and half a tick a quarter of it.
    assert errors_m[0] < 30e-9
    assert errors_m[1] < 0.26 * errors_m[0]


def test_the_gap_is_taken_up_on_the_flank_that_drives() -> None:
    screw_m, wanted_m, moved_m = Bench(**BACKLASH).run(swell_m())
    ahead_m = screw_m - wanted_m
    rising = np.gradient(wanted_m) > 0
    # Clear of the turns by the quarter of the backlash that a turn must have, and two ticks.
    clear = np.minimum(wanted_m, 0.3e-3 - wanted_m) > LEAST_TURN_M + 1.5e-6
    assert clear.mean() > 0.7
    assert ahead_m[clear & rising] == pytest.approx(BACKLASH_M / 2, abs=1e-12)
    assert ahead_m[clear & ~rising] == pytest.approx(-BACKLASH_M / 2, abs=1e-12)
    assert moved_m[clear] == pytest.approx(wanted_m[clear], abs=1e-12)
    # Where it turns, the tip is off by no more than a turn that counts and the way of a tick.
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
    # Where a leg begins or ends the rotor's inverse asks for more than the flank does.
    behind = screw_m - wanted_m < 0
    assert behind[110:].any() == crossed
    assert not behind[:90].any()


def test_small_turns_one_after_the_other_are_not_added_up() -> None:
    bench = Bench(**BACKLASH)
    small_m = 0.9 * LEAST_TURN_M
    steps_m = [50e-6, 50e-6 - small_m] * 6
    screw_m, wanted_m, _ = bench.run(up_and_down_m(0, *steps_m, ticks=20))
    assert screw_m - wanted_m == pytest.approx(BACKLASH_M / 2, abs=1e-12)


def test_a_slow_way_down_is_one_turn_however_slow() -> None:
    bench = Bench(**BACKLASH)
    screw_m, wanted_m, _ = bench.run(up_and_down_m(0, 50e-6, 40e-6, ticks=2000))
    ahead_m = screw_m - wanted_m
    changes = np.flatnonzero(np.abs(np.diff(ahead_m)) > 1e-12)
    assert len(changes) == 1
    fallen_m = 50e-6 - wanted_m[changes[0] + 1]
    assert fallen_m == pytest.approx(LEAST_TURN_M, rel=0.02)


def crossing_m(**table: object) -> Positions:
    """The screw's offset from a way up to one down, the turn being sharp."""
    gap = Gap(scene(**BACKLASH, **table), 1e-3)
    tip_m = up_and_down_m(0, 0.5e-3, 0).tolist()
    reach = 2 + gap.lead
    return np.array([gap.cross(tip_m[k : k + reach]) for k in range(len(tip_m) - reach)])


def ringing_m(offsets_m: Positions, resonance_hz: float, damping: float, rest: int) -> float:
    """How far the rotor still swings after tick `rest`."""
    rotor = Rotor(resonance_hz, damping, 1e-3)
    rotor.position_m = offsets_m[0]
    turned_m = [rotor.step(from_m, to_m) for from_m, to_m in pairwise(offsets_m.tolist())]
    return float(np.abs(np.array(turned_m[rest : rest + 40]) - offsets_m[-1]).max())


@pytest.mark.parametrize("damping", [0.0, 0.05, 0.2])
@pytest.mark.parametrize("resonance_hz", [37.0, 63.0, 80.0, 100.0, 130.0])
def test_after_a_crossing_the_rotor_rests(resonance_hz: float, damping: float) -> None:
    offsets_m = crossing_m(rotor_resonance=f"{resonance_hz} Hz", rotor_damping=damping)
    assert offsets_m[[0, -1]] == pytest.approx([BACKLASH_M / 2, -BACKLASH_M / 2])
    changes = np.flatnonzero(np.diff(offsets_m))
    jump_m = np.where(np.arange(len(offsets_m)) > changes[0], offsets_m[-1], offsets_m[0])
    rest = int(changes[-1]) + 1
    shaped_m = ringing_m(offsets_m, resonance_hz, damping, rest)
    assert shaped_m < 0.03 * ringing_m(jump_m, resonance_hz, damping, rest)
    # The second step comes half a period after the first.
    damped_hz = resonance_hz * math.sqrt(1 - damping**2)
    assert changes[-1] - changes[0] == pytest.approx(500 / damped_hz, abs=1)


@pytest.mark.parametrize("table", [{}, {"rotor_resonance": "100 Hz", "rotor_damping": 1.0}])
def test_without_a_ringing_rotor_the_gap_is_crossed_at_once(table: dict[str, object]) -> None:
    assert np.count_nonzero(np.diff(crossing_m(**table))) == 1


def test_the_turn_lies_between_the_two_steps() -> None:
    # The tip is at its highest at tick 100.
    rigid, ringing = (np.flatnonzero(np.diff(crossing_m(**table))) + 1 for table in ({}, ROTOR))
    assert rigid[0] == 100
    assert ringing[0] == 99 < 100 < ringing[-1]


def test_coasted_ticks_go_on_at_the_last_speed() -> None:
    missed = 7
    reference_n = Bench().reference_n(up_and_down_m(0, 50e-6))
    bench = Bench()
    speeds = [bench.path.advance(reference_n[tick : tick + 2]) for tick in range(20)]
    for _ in range(missed):
        bench.path.shift(speeds[-1] * 1e-3)
    # On a straight way it is where it should be, and goes on as if nothing had been missed.
    tick = 20 + missed
    assert bench.path.advance(reference_n[tick : tick + 2]) == pytest.approx(speeds[-1], rel=1e-6)


def test_what_was_coasted_too_far_is_taken_back() -> None:
    bench = Bench()
    reference_n = bench.reference_n(np.array([10e-6, 11e-6, 11e-6]))
    speed = bench.path.advance(reference_n[:2])
    for _ in range(5):
        bench.path.shift(speed * 1e-3)
    assert bench.path.advance(reference_n[1:]) == pytest.approx(-5 * speed, rel=1e-6)


def test_before_the_first_tick_nothing_is_coasted() -> None:
    bench, fresh = Bench(), Bench()
    bench.path.shift(0.1 * 1e-3)
    reference_n = bench.reference_n(np.array([10e-6, 11e-6]))
    assert bench.path.advance(reference_n) == fresh.path.advance(reference_n)
