import pytest

from soak.faults import Done
from soak.felt import FeltLog
from soak.recovery import Played, gaps_s, recoveries, undisturbed_gaps_s
from soak.schedule import CONTINUOUS, RESTARTED, TEMPORARY, Fault

S = 1_000_000_000
BOTH = (CONTINUOUS, RESTARTED)


def log(*spells_s: tuple[float, float]) -> FeltLog:
    result = FeltLog(1_000_000)
    result.spells = [(round(begin * S), round(end * S)) for begin, end in spells_s]
    return result


def done(kind: str, over_s: float, *displays: str, for_s: float = 2.0) -> Done:
    return Done(Fault(kind, "", 0.0, for_s), 10 * S, round(over_s * S), displays)


FELT = {
    CONTINUOUS: log((0, 10.1), (13.4, 60)),
    RESTARTED: log((0, 10.1), (12.9, 60)),
    TEMPORARY: log((30.8, 34.0)),
}


def test_each_display_is_judged_by_what_was_done_to_it() -> None:
    kill, cut = done("kill sensing", 12.5, *BOTH), done("cut", 13.0, CONTINUOUS)
    found = recoveries([Played((kill, cut), 10 * S, 17 * S)], FELT)
    assert found == {
        "cut + kill sensing": [pytest.approx(0.4)],
        "kill sensing": [pytest.approx(0.4)],
    }


def test_a_temporary_display_joins_and_the_others_must_not_notice() -> None:
    visit = Played((done("temporary display", 30.0, TEMPORARY, for_s=4.0),), 29 * S, 40 * S)
    assert recoveries([visit], FELT) == {"temporary display": [pytest.approx(0.8)]}
    assert undisturbed_gaps_s([visit], FELT) == [0.0, 0.0]
    # It left before it felt anything; with another fault at the time, this proves nothing.
    brief = Played((done("temporary display", 30.0, TEMPORARY, for_s=0.5),), 29 * S, 40 * S)
    assert recoveries([brief], FELT) == {"temporary display": [None]}
    pair = Played((*brief.done, done("cut", 31.0, RESTARTED)), 29 * S, 40 * S)
    assert recoveries([pair], FELT) == {"cut": [0.0]}


def test_a_display_beside_a_fault_is_known_by_its_gaps() -> None:
    cut = Played((done("cut", 13.0, CONTINUOUS),), 10 * S, 17 * S)
    assert undisturbed_gaps_s([cut], FELT) == [pytest.approx(2.8)]
    assert gaps_s([cut], FELT[CONTINUOUS]) == [pytest.approx(3.3)]
