import math
from itertools import pairwise

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from display_node.control.force_bounds import ForceBounds
from display_node.control.link_loss import Fade
from display_node.control.scene import SafetyScene
from protocol.faults import Fault, FaultKind, Part

TICK_NS = 1_000_000
LIMIT_N = 2.5
SLEW_N = 0.05
ROUNDING_N = 1e-12


class OneContactor(Fade):
    """The fade of a display with one contactor, whose bounds it applies."""

    def __init__(self, scene: SafetyScene, tick_ns: int) -> None:
        super().__init__(scene, tick_ns)
        self.bounds = ForceBounds(scene, tick_ns)

    def bound(self, reference_n: list[float], alive: bool) -> list[float]:
        return self.bounds.bound(reference_n, self.advance(alive))

    def watch(self, feedback_n: float) -> None:
        fault = self.bounds.reading_fault(feedback_n, 1)
        if fault is not None:
            self.fault(fault)


def one_contactor(tick_ns: int = TICK_NS, **table: object) -> OneContactor:
    return OneContactor(SafetyScene.model_validate(table), tick_ns)


def at_full_strength() -> OneContactor:
    """Return a contactor at 0 N after its ramp."""
    ready = one_contactor()
    while ready.gain < 1.0:
        ready.bound([0.0, 0.0], alive=True)
    return ready


def ticked(under_test: OneContactor, force_n: float, ticks: int, alive: bool = True) -> list[float]:
    return [under_test.bound([force_n, force_n], alive)[0] for _ in range(ticks)]


@settings(deadline=None)
@given(
    st.lists(
        st.tuples(st.floats(), st.floats(), st.booleans(), st.floats(-1, 4) | st.just(math.nan)),
        max_size=100,
    )
)
def test_no_sequence_exceeds_force_or_slew_limit(
    ticks: list[tuple[float, float, bool, float]],
) -> None:
    under_test = at_full_strength()
    last_n = 0.0
    for now_n, next_n, alive, feedback_n in ticks:
        under_test.watch(feedback_n)
        bounded_n = under_test.bound([now_n, next_n], alive)
        assert len(bounded_n) == 2
        assert all(0.0 <= force_n <= LIMIT_N for force_n in bounded_n)
        assert abs(bounded_n[0] - last_n) <= SLEW_N + ROUNDING_N
        assert abs(bounded_n[1] - bounded_n[0]) <= SLEW_N + ROUNDING_N
        last_n = bounded_n[0]


@settings(deadline=None)
@given(st.lists(st.floats(0.5, 1.5), min_size=3, max_size=50))
def test_a_reference_within_the_bounds_passes_unchanged(forces_n: list[float]) -> None:
    under_test = one_contactor(slew_limit="1000000 N/s")
    ticked(under_test, forces_n[0], 600)
    for now_n, next_n in pairwise(forces_n):
        assert under_test.bound([now_n, next_n], alive=True) == [now_n, next_n]


@pytest.mark.parametrize(
    ("force_n", "expected_n"),
    [
        (1.0, 1.0), (100.0, LIMIT_N), (1e308, LIMIT_N), (math.inf, LIMIT_N), (-1.0, 0.0),
        (-math.inf, 0.0), (math.nan, 0.0),
    ],
)  # fmt: skip
def test_a_force_is_limited(force_n: float, expected_n: float) -> None:
    assert ticked(at_full_strength(), force_n, 100)[-1] == expected_n


def test_the_slew_limit_does_not_depend_on_the_tick() -> None:
    for tick_ns in (100_000, 1_000_000, 10_000_000):
        under_test = one_contactor(tick_ns, ramp="1 ms")
        ticked(under_test, 0.0, 20)
        assert under_test.bound([2.0, 2.0], True)[0] == pytest.approx(50 * tick_ns * 1e-9)


def test_jumps_of_the_reference_are_followed_at_the_slew_limit() -> None:
    under_test = at_full_strength()
    rising_n = ticked(under_test, 1.0, 21)
    assert rising_n[:20] == pytest.approx([SLEW_N * tick for tick in range(1, 21)])
    assert rising_n[20] == 1.0
    falling_n = ticked(under_test, 0.2, 17)
    assert falling_n[:16] == pytest.approx([1 - SLEW_N * tick for tick in range(1, 17)])
    assert falling_n[16] == pytest.approx(0.2)
    # The limit also holds between the two values of one reference.
    assert under_test.bound([0.2, 1.0], alive=True)[1] == pytest.approx(0.2 + SLEW_N)
    assert under_test.bound([0.2, 0.0], alive=True)[1] == pytest.approx(0.2 - SLEW_N)


def test_the_force_starts_at_rest_and_ramps_up() -> None:
    under_test = one_contactor(ramp="500 ms")
    assert under_test.gain == 0.0
    felt_n = ticked(under_test, 1.0, 501)
    assert felt_n == pytest.approx([tick / 500 for tick in range(1, 501)] + [1.0])
    assert felt_n[500] == under_test.gain == 1.0


def test_a_stale_stream_fades_to_zero() -> None:
    under_test = at_full_strength()
    ticked(under_test, 1.0, 100)
    fading_n = ticked(under_test, 1.0, 45, alive=False)
    assert fading_n[:40] == pytest.approx([1 - tick / 40 for tick in range(1, 41)], abs=1e-9)
    assert fading_n[40:] == [0.0] * 5
    assert under_test.gain < 1.0


def test_after_a_short_gap_the_ramp_starts_where_the_fade_ended() -> None:
    under_test = at_full_strength()
    ticked(under_test, 1.0, 100)
    assert ticked(under_test, 1.0, 10, alive=False)[-1] == pytest.approx(0.75)
    back_n = ticked(under_test, 1.0, 76)
    assert back_n[0] == pytest.approx(0.75 + 1 / 300)
    assert back_n[-1] == 1.0


TOO_HIGH, NO_NUMBER = FaultKind.OVERFORCE, FaultKind.NOT_A_NUMBER


@pytest.mark.parametrize(
    ("feedback_n", "faults"),
    [
        (math.nan, [NO_NUMBER]), (math.inf, [NO_NUMBER]), (-math.inf, [NO_NUMBER]),
        (2.7, []), (2.71, [TOO_HIGH]), (-2.71, [TOO_HIGH]), (-0.5, []),
    ],
)  # fmt: skip
def test_an_implausible_reading_is_a_fault(feedback_n: float, faults: list[FaultKind]) -> None:
    under_test = at_full_strength()
    under_test.watch(feedback_n)
    assert [fault.kind for fault in under_test.faults] == faults


def test_a_fault_keeps_the_target_at_zero() -> None:
    under_test = at_full_strength()
    ticked(under_test, 1.0, 100)
    for feedback_n in (9.0, 9.0, math.nan, 1.0):
        under_test.watch(feedback_n)
    assert [fault.kind for fault in under_test.faults] == [TOO_HIGH, NO_NUMBER]
    assert ticked(under_test, 1.0, 45)[-1] == 0.0
    assert max(ticked(under_test, 1.0, 2000)) == 0.0


def counted(under_test: OneContactor) -> dict[str, tuple[int, int]]:
    """Return times and ticks of each bound that was in effect."""
    names = ("at_force_limit", "below_zero", "at_slew_limit")
    counters = {name: getattr(under_test.bounds, name) for name in names}
    return {name: (c.times, c.ticks) for name, c in counters.items() if c.times}


def test_each_time_and_tick_at_a_limit_is_counted() -> None:
    under_test = at_full_strength()
    ticked(under_test, LIMIT_N - 0.02, 100)
    assert counted(under_test) == {"at_slew_limit": (1, 49)}
    for _ in range(3):
        ticked(under_test, LIMIT_N + 0.01, 10)
        ticked(under_test, LIMIT_N, 5)
    assert counted(under_test) == {"at_slew_limit": (1, 49), "at_force_limit": (3, 30)}


@pytest.mark.parametrize(("force_n", "ticks"), [(-0.2, 7), (math.nan, 7), (-1e-4, 0), (0.0, 0)])
def test_negative_forces_and_nan_are_counted(force_n: float, ticks: int) -> None:
    under_test = at_full_strength()
    ticked(under_test, force_n, 7)
    assert counted(under_test) == ({"below_zero": (1, ticks)} if ticks else {})


def test_ramp_and_fade_do_not_count_as_limits() -> None:
    under_test = one_contactor()
    for _ in range(5):
        ticked(under_test, 2.0, 400)
        # Without a stream there is no reference: the slew limit brings the tip to rest.
        ticked(under_test, 0.0, 60, alive=False)
    under_test.fault(Fault(FaultKind.UNPLUGGED, Part.DRIVE, "any"))
    ticked(under_test, 0.0, 60)
    assert counted(under_test) == {}
