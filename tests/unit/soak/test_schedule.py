from itertools import islice

import pytest

from soak.schedule import (
    BENCH_KINDS,
    BENCH_WATCHDOG_S,
    ENDING_DECKS,
    KINDS,
    RESTARTED,
    SENSING_ENDS,
    Episode,
    Fault,
    episodes,
    troubles,
)


def taken(seed: int, count: int) -> list[Episode]:
    return list(islice(episodes(seed), count))


def faults(seed: int, count: int) -> list[Fault]:
    return [fault for episode in taken(seed, count) for fault in episode.faults]


def test_the_same_seed_gives_the_same_faults_and_another_one_others() -> None:
    assert taken(7, 50) == taken(7, 50)
    assert taken(7, 50) != taken(8, 50)


@pytest.mark.parametrize("seed", range(20))
def test_every_kind_has_its_turn(seed: int) -> None:
    kinds = [fault.kind for fault in faults(seed, 3 * len(KINDS))][: 3 * len(KINDS)]
    # A fault that was postponed for its partner is one place late.
    assert len(set(KINDS) - set(kinds[: len(KINDS) + 1])) == 0
    assert {kinds.count(kind) for kind in KINDS} <= {2, 3, 4}


def test_at_last_the_sensing_node_is_no_more_ended() -> None:
    kinds = [fault.kind for fault in faults(1, 400)]
    ends = [position for position, kind in enumerate(kinds) if kind in SENSING_ENDS]
    assert len(ends) == ENDING_DECKS * len(SENSING_ENDS)
    assert max(ends) <= ENDING_DECKS * len(KINDS)
    assert set(kinds[-len(KINDS) :]) == set(KINDS) - set(SENSING_ENDS)


def test_two_faults_at_once_overlap_and_are_done_to_different_parts() -> None:
    pairs = [episode.faults for episode in taken(1, 400) if len(episode.faults) == 2]
    assert 50 < len(pairs) < 150
    for first, second in pairs:
        assert first.target != second.target
        assert 0 <= second.after_s <= first.for_s


def test_only_the_restarted_display_is_ever_killed() -> None:
    ends = [x for x in faults(1, 400) if x.kind in ("kill display", "restart display")]
    assert {fault.target for fault in ends} == {RESTARTED}


def test_there_is_time_to_be_felt_again_after_every_episode() -> None:
    assert min(episode.rest_s for episode in taken(1, 400)) >= 3.0
    assert all(fault.for_s > 0 for fault in faults(1, 400))


@pytest.mark.parametrize("seed", range(20))
def test_every_trouble_of_the_bench_has_its_turn(seed: int) -> None:
    found = list(islice(troubles(seed), 2 * len(BENCH_KINDS)))
    assert found == list(islice(troubles(seed), 2 * len(BENCH_KINDS)))
    kinds = [trouble.kind for trouble in found]
    assert set(kinds[: len(BENCH_KINDS)]) == set(BENCH_KINDS)
    assert kinds[0] == "long stall"
    assert all(kinds.count(kind) == 2 for kind in BENCH_KINDS)
    lengths_s = {kind: [x.for_s for x in found if x.kind == kind] for kind in BENCH_KINDS}
    assert lengths_s["cut"] == [0.0, 0.0]
    assert 0 < max(lengths_s["short stall"]) < BENCH_WATCHDOG_S < min(lengths_s["long stall"])
