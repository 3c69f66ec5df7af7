import math

import numpy as np
import pytest
from scipy.special import ndtr

from telepulse.experiment.observer import SimulatedObserver


@pytest.mark.parametrize("apart", [0.0, 0.7, 2.0, 4.0])
def test_the_observer_does_as_its_equation_says(apart: float) -> None:
    """Compare with the share of right answers of the differencing strategy for a d' of `apart`."""
    of = 4_000
    observer = SimulatedObserver(1.0, round(10 * apart))
    right = 0
    for trial in range(of):
        a, b = (apart, 0.0) if trial % 2 else (0.0, apart)
        x = a if trial % 3 else b
        right += observer.identify(a, b, x) == ("A" if trial % 3 else "B")
    nearer, aside = apart / math.sqrt(2), apart / 2 / math.sqrt(1.5)
    share = ndtr(nearer) * ndtr(aside) + ndtr(-nearer) * ndtr(-aside)
    assert abs(right / of - share) < 4 * math.sqrt(0.25 / of)


def test_ratings_fall_with_the_error() -> None:
    observer = SimulatedObserver(0.05, 1)
    means = [np.mean([observer.rate(0.0, error) for _ in range(400)]) for error in (0, 0.1, 0.5)]
    assert means[0] > 4
    assert means[0] > means[1] > means[2] == 1
