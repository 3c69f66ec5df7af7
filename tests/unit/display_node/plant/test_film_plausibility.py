"""Readings of a real film that cannot be true."""

import math
from collections.abc import Callable

import pytest

from display_node.plant.film_plausibility import SOFTEST, WITHIN_NS, FilmPlausibility, RisingForce
from protocol.faults import Fault
from tests.support.drive_benches import LAYER, stepper

MS = 1_000_000
LAW = stepper(fingertip="1 N/mm").contact(LAYER)


def swing_m(at_ms: int) -> float:
    """Return the position of a pressing tip that moves by ±0.3 mm."""
    return 0.9e-3 + 0.3e-3 * math.sin(at_ms / 50)


def contradiction(
    position_m: float | Callable[[int], float], force_n: float | Callable[[int], float], ms: int
) -> Fault | None:
    """Return the first fault of a film within `ms`; positions and readings may depend on time."""
    film = FilmPlausibility(stepper(fingertip="1 N/mm"), LAYER)
    for at_ms in range(0, ms, 5):
        film.add_position(position_m(at_ms) if callable(position_m) else position_m, at_ms * MS)
        reading_n = force_n(at_ms) if callable(force_n) else force_n
        if (fault := film.check_reading(reading_n, at_ms * MS)) is not None:
            return fault
    return None


@pytest.mark.parametrize("force_n", [0.0, 0.1, 0.5, 1.0, 2.5])
@pytest.mark.parametrize("finger", [SOFTEST, 1.0, 4.0])
def test_a_human_finger_is_no_contradiction(force_n: float, finger: float) -> None:
    place_m = stepper(fingertip=f"{finger} N/mm").contact(LAYER).position(force_n)
    for nearer_m in (-0.4e-3, 0.0, 0.4e-3):
        assert contradiction(place_m + nearer_m, force_n, 200) is None


@pytest.mark.parametrize(
    ("position_m", "force_n", "fault"),
    [
        (LAW.position(2.5), 0.0, "it reads 0 mN where the tip presses with"),
        (LAW.position(0.7), 0.0, "it reads 0 mN where the tip presses with"),
        (-2e-3, 0.3, "it reads 300 mN where the tip is 2.0 mm off the finger"),
        (swing_m, 0.55, "it reads 550 mN unchanged"),
    ],
)
def test_an_impossible_reading_is_a_fault(
    position_m: float | Callable[[int], float], force_n: float, fault: str
) -> None:
    assert fault in str(contradiction(position_m, force_n, 600))


@pytest.mark.parametrize(
    ("position_m", "force_n", "ms"),
    [
        pytest.param(-0.8e-3, 0.3, 200, id="near the finger"),
        pytest.param(LAW.position(2.5), 0.0, WITHIN_NS // MS, id="50 ms"),
        pytest.param(LAW.position(2.5), lambda ms: 0.0 if ms % 40 else 2.5, 500, id="repeated"),
        pytest.param(
            lambda ms: LAW.position(2.5 if ms % 40 else 0.0), lambda ms: 1e-4 * (ms % 10), 500,
            id="motion within 50 ms",
        ),
        pytest.param(swing_m, lambda ms: LAW.force(swing_m(ms)), 600, id="moving tip"),
        pytest.param(lambda ms: swing_m(ms) - 1.2e-3, 0.0, 2_000, id="unchanged off the finger"),
    ],
)  # fmt: skip
def test_a_possible_or_short_reading_is_no_fault(
    position_m: float | Callable[[int], float], force_n: float | Callable[[int], float], ms: int
) -> None:
    assert contradiction(position_m, force_n, ms) is None


def rise(n_per_s: float, end_n: float = 3.5) -> Fault | None:
    """Return the fault of a ramp up to its end, if there is one."""
    rising, ms, found = RisingForce(2.7, 50.0, 8 * MS), 0, None
    while found is None and n_per_s * ms * 1e-3 <= end_n:
        found = rising.check_reading(n_per_s * ms * 1e-3, ms * MS)
        ms += 1
    return found


@pytest.mark.parametrize("n_per_s", [80.0, 100.0, 150.0])
def test_a_fast_rise_is_a_fault_early_enough_to_reverse(n_per_s: float) -> None:
    fault = rise(n_per_s)
    assert fault is not None
    at_n = float(fault.cause.split(" at ")[1].split(" N")[0])
    # The film is 8 ms late, and the motor reverses 3 ms after that.
    assert at_n + n_per_s * 11e-3 < 1.25 * 2.5


def test_a_commanded_rise_and_short_noise_are_no_fault() -> None:
    assert rise(10.0, end_n=2.5) is None
    assert rise(50.4, end_n=2.5) is None
    rising = RisingForce(2.7, 50.0, 8 * MS)
    for ms in range(200):
        assert rising.check_reading(0.3 + 0.1 * (ms % 7 == 0), ms * MS) is None
