"""The display's process is stalled at random, on a bench in virtual time."""

import pytest

from benchmarks.lies import KINDS
from benchmarks.random_stalls import Ordeal

# Hours of it: `make bench ARGS=random_stalls`.
SECONDS = 30.0


@pytest.mark.parametrize("seed", [1, 2])
@pytest.mark.parametrize("with_film", [True, False], ids=["film", "no film"])
def test_no_stall_leaves_the_tip_pressed(with_film: bool, seed: int) -> None:
    tally = Ordeal(KINDS[seed % 2], with_film, seed).run(SECONDS)
    assert tally.episodes.total() >= 3
    assert tally.withdrawn.total() >= 1
    assert tally.examples == []
    # A pulse of 0.55 N; a stall holds the last command.
    assert tally.most_n < 1.25 * 0.55 + 0.1
