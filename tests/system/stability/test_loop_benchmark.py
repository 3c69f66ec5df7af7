"""What `make bench ARGS=loop` comes to: the verdict of each hard case, and the order of the ways.

Costs are not judged here: they are the machine's.
"""

import math

import pytest

from benchmarks.loop.hard_cases import BOUNDED, REFUSED, SETTLES, UNBOUNDED, cases, play
from benchmarks.loop.stepping import SCENES, SHIPPED, TICKS_S, USUAL_S, Score, score

EXPLICIT, EXACT = "explicit, as in the paper", "exact: the loop's matrix exponential"
# All others settle.
NOT_SETTLED = {
    ("paper", "film with a lag of 30 ms"): REFUSED,
    ("paper", "output of at most 10 V"): BOUNDED,
    ("radial", "film with a lag of 30 ms"): REFUSED,
    ("radial", "finger of 1000 N/mm, scene 1 N/mm"): BOUNDED,
    ("radial", "layer of 1 Pa"): BOUNDED,
    ("radial", "rotor that rings: 100 Hz, ζ = 0.02"): REFUSED,
    ("radial", "rotor that rings, not in the scene"): BOUNDED,
    ("real_bench", "finger of 0.01 N/mm, scene 1 N/mm"): BOUNDED,
    ("real_bench", "finger of 1000 N/mm, scene 1 N/mm"): BOUNDED,
    ("real_bench", "layer of 1 Pa"): BOUNDED,
}
NAMED = [(name, label) for name in SCENES for label in cases(name)]


@pytest.mark.parametrize(("name", "label"), NAMED)
def test_the_verdict_of_a_hard_case(name: str, label: str) -> None:
    outcome = play(name, cases(name)[label])
    assert outcome.verdict == NOT_SETTLED.get((name, label), SETTLES), outcome
    assert outcome.verdict != UNBOUNDED
    # A film that is broken ends the pulse, also where it reads again.
    assert ("not a number" in outcome.reason) == ("NaN" in label)
    assert ("stable" in outcome.reason) == (outcome.verdict == REFUSED)


def test_every_exception_is_a_case() -> None:
    assert set(NOT_SETTLED) <= set(NAMED)


@pytest.fixture(scope="module", params=SCENES)
def scores(request: pytest.FixtureRequest) -> dict[str, Score]:
    found, halved = score(request.param)
    # The reference is far better than what is compared with it.
    assert halved < 1e-10
    return {each.way: each for each in found}


def following(each: Score) -> list[float]:
    return [errors.following for errors in each.errors.values() if errors is not None]


def catching_up(each: Score) -> list[float]:
    return [errors.catching_up for errors in each.errors.values() if errors is not None]


def test_only_the_papers_explicit_way_diverges_and_from_2_ms_on(scores: dict[str, Score]) -> None:
    diverged = {
        (way, tick_s)
        for way, each in scores.items()
        for tick_s, errors in each.errors.items()
        if errors is None or math.isinf(errors.following)
    }
    scene = scores[SHIPPED].scene
    slow = {(EXPLICIT, tick_s) for tick_s in TICKS_S if tick_s >= 2e-3}
    assert diverged == (slow if scene == "paper" else set())


def test_the_displays_way_follows_better_than_the_papers(scores: dict[str, Score]) -> None:
    own, papers = following(scores[SHIPPED]), following(scores[EXPLICIT])
    assert all(one < other for one, other in zip(own, papers, strict=True))
    usual = scores[SHIPPED].errors[USUAL_S]
    assert usual is not None
    assert usual.following <= 2.5e-4
    if scores[SHIPPED].scene == "radial":
        # Known in advance, its path is exact; what is left is rounding.
        assert max(own) <= 1e-9


def test_the_exact_way_is_of_second_order_and_the_library_no_better(
    scores: dict[str, Score],
) -> None:
    exact, solved = catching_up(scores[EXACT]), catching_up(scores[SHIPPED])
    precise = catching_up(scores["`solve_ivp`, 1e-9"])
    # Solved by backward Euler, a correction takes longer.
    assert all(one < 0.2 * other for one, other in zip(exact, solved, strict=True))
    if scores[EXACT].scene == "radial":
        assert max(exact) <= 1e-14
        assert max(precise) <= 1e-10
    else:
        assert exact[2] / exact[1] == pytest.approx(4, rel=0.05)
        assert precise == pytest.approx(exact, rel=1e-3)
