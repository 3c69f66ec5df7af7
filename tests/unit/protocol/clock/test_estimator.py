import random
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import pytest
from hypothesis import given
from hypothesis import strategies as st

from protocol.clock.estimator import BLOCK, ClockEstimator, ClockExchange, block_offset

MS = 1_000_000
S = 1_000 * MS


def exchange(t_ns: int, there_ms: float, back_ms: float, offset_ns: int = 0) -> ClockExchange:
    arrives_ns = t_ns + round(there_ms * MS)
    shown_ns = arrives_ns + offset_ns
    return ClockExchange(t_ns, shown_ns, shown_ns, arrives_ns + round(back_ms * MS))


def test_a_known_skew_is_removed_from_the_delays() -> None:
    skew = 500e-6
    block = [exchange(i * S, 20, 20, round(i * S * skew)) for i in range(BLOCK)]
    blind = block_offset(block, block[0], 0.0, 0.0)
    seeing = block_offset(block, block[0], skew, 0.0)
    assert seeing["round_trip_ns"][0] == pytest.approx(40 * MS, abs=100_000)
    assert blind["round_trip_ns"][0] < 34 * MS
    doubtful = block_offset(block, block[0], 0.0, 2 * skew)
    assert doubtful["round_trip_ns"][0] > 40 * MS


HOUR = 3_600 * S
Jitter = Callable[[random.Random], float]

JITTERS: dict[str, Jitter] = {
    "none": lambda rng: 0,
    "exponential of 5 ms": lambda rng: rng.expovariate(1 / (5 * MS)),
    "exponential of 50 ms": lambda rng: rng.expovariate(1 / (50 * MS)),
    "heavy-tailed": lambda rng: min(2 * S, MS * rng.paretovariate(1.1)),
    "in bursts": lambda rng: rng.uniform(0, 400 * MS) if rng.random() < 0.7 else 0,
    "uniform to 200 ms": lambda rng: rng.uniform(0, 200 * MS),
}
MODEST = JITTERS["exponential of 5 ms"]


@dataclass
class Remote:
    """A remote clock behind a link, with four exchanges a second; local time begins at 5 s."""

    offset_ns: int = HOUR
    skew: float = 0.0
    delay_ns: int = 20 * MS
    extra_request_ns: int = 0
    jitter: Jitter = JITTERS["none"]
    seed: int = 1
    local_ns: float = 5 * S

    def __post_init__(self) -> None:
        self.rng = random.Random(self.seed)

    def now_ns(self, local_ns: float) -> int:
        return round(local_ns + self.offset_ns + self.skew * local_ns)

    def exchange(self) -> ClockExchange:
        sent_ns = self.local_ns
        there_ns = sent_ns + self.delay_ns + self.extra_request_ns + self.jitter(self.rng)
        answered_ns = there_ns + 50_000
        back_ns = answered_ns + self.delay_ns + self.jitter(self.rng)
        self.local_ns = max(sent_ns + 250 * MS, back_ns)
        return ClockExchange(
            round(sent_ns), self.now_ns(there_ns), self.now_ns(answered_ns), round(back_ns)
        )

    def error_ns(self, estimator: ClockEstimator) -> int:
        local_ns = round(self.local_ns)
        return abs(estimator.remote_ns(local_ns) - self.now_ns(local_ns))


def follow(remote: Remote, estimator: ClockEstimator, seconds: float) -> Iterator[int]:
    """Exchange for some seconds; yield the estimate's error after each exchange."""
    end_ns = remote.local_ns + seconds * S
    while remote.local_ns < end_ns:
        assert estimator.add(remote.exchange())
        yield remote.error_ns(estimator)


def followed(remote: Remote, seconds: float) -> ClockEstimator:
    estimator = ClockEstimator()
    list(follow(remote, estimator, seconds))
    return estimator


def test_the_first_exchange_gives_the_offset_and_the_third_makes_it_ready() -> None:
    estimator, remote = ClockEstimator(), Remote(offset_ns=-HOUR)
    assert not estimator.ready
    estimator.add(remote.exchange())
    assert estimator.offset_ns(round(remote.local_ns)) == -HOUR
    # One exchange may be wrong by half of its round trip.
    assert estimator.uncertainty_ns(round(remote.local_ns)) >= estimator.asymmetry_bound_ns
    assert estimator.asymmetry_bound_ns == 20 * MS
    for ready in (False, True):
        estimator.add(remote.exchange())
        assert estimator.ready is ready


@pytest.mark.parametrize("offset_ns", [-HOUR, 0, 50 * 365 * 24 * HOUR])
@pytest.mark.parametrize("skew_ppm", [-200, 0, 50])
def test_without_jitter_offset_and_skew_are_found_exactly(skew_ppm: int, offset_ns: int) -> None:
    remote = Remote(offset_ns, skew_ppm * 1e-6)
    estimator = followed(remote, 60)
    assert remote.error_ns(estimator) < 20_000
    assert estimator.skew_ppm == pytest.approx(skew_ppm, abs=0.1)
    remote.local_ns += 60 * S
    assert remote.error_ns(estimator) < 50_000


@pytest.mark.parametrize("extra_ns", [0, 10 * MS, 40 * MS])
def test_an_error_by_asymmetric_delays_is_within_the_bound(extra_ns: int) -> None:
    remote = Remote(extra_request_ns=extra_ns)
    estimator = followed(remote, 30)
    assert remote.error_ns(estimator) == pytest.approx(extra_ns / 2, abs=1000)
    assert remote.error_ns(estimator) <= estimator.asymmetry_bound_ns


@pytest.mark.parametrize(
    "exchange",
    [
        ClockExchange(100, 0, 0, 99),
        ClockExchange(100, 1000, 1051, 150),
        ClockExchange(100, 1001, 1000, 150),
    ],
    ids=["received before sent", "longer there than away", "answered before received"],
)
def test_an_impossible_exchange_is_refused(exchange: ClockExchange) -> None:
    estimator = followed(Remote(), 10)
    before = estimator.remote_ns(20 * S), estimator.uncertainty_ns(20 * S)
    assert not estimator.add(exchange)
    assert (estimator.remote_ns(20 * S), estimator.uncertainty_ns(20 * S)) == before


@pytest.mark.parametrize("before_s", [1, 3, 30, 90])
@pytest.mark.parametrize("step_ns", [HOUR, -HOUR, S], ids=["1 h", "-1 h", "1 s"])
@pytest.mark.parametrize("jitter", ["none", "exponential of 5 ms"])
def test_a_step_is_detected_and_followed(jitter: str, step_ns: int, before_s: int) -> None:
    remote = Remote(skew=50e-6, jitter=JITTERS[jitter])
    estimator = followed(remote, before_s)
    remote.offset_ns += step_ns
    for _ in range(5):
        estimator.add(remote.exchange())
    assert estimator.steps == 1
    assert estimator.ready
    assert remote.error_ns(estimator) < 20 * MS
    errors_ns = list(follow(remote, estimator, 100))
    assert estimator.steps == 1
    assert errors_ns[-1] < 1 * MS


@pytest.mark.parametrize("skew_ppm", [-200, 0, 200])
@pytest.mark.parametrize("jitter", JITTERS)
def test_jitter_is_no_step(jitter: str, skew_ppm: int) -> None:
    for seed in range(3):
        # Without jitter also at a round trip that is short beside the skew.
        for delay_ns in (20 * MS, 50_000) if jitter == "none" else (20 * MS,):
            remote = Remote(0, skew_ppm * 1e-6, delay_ns, jitter=JITTERS[jitter], seed=seed)
            assert followed(remote, 150).steps == 0


@pytest.mark.parametrize("before_s", [2, 30])
@pytest.mark.parametrize("late_ns", [200 * MS, 2 * S])
def test_one_long_round_trip_changes_the_estimate_little(late_ns: int, before_s: int) -> None:
    remote = Remote()
    estimator = followed(remote, before_s)
    remote.extra_request_ns = late_ns
    estimator.add(remote.exchange())
    assert remote.error_ns(estimator) < 0.2 * MS


@pytest.mark.parametrize("before_s", [1, 30])
def test_one_or_two_contradicting_exchanges_change_nothing(before_s: int) -> None:
    remote = Remote()
    estimator = followed(remote, before_s)
    for _ in range(3):
        remote.offset_ns += HOUR
        estimator.add(remote.exchange())
        estimator.add(remote.exchange())
        remote.offset_ns -= HOUR
        estimator.add(remote.exchange())
        assert remote.error_ns(estimator) < 1000
    assert estimator.steps == 0


@pytest.mark.parametrize("step_ns", [-15 * MS, 15 * MS])
def test_a_step_below_the_round_trip_is_detected_after_some_blocks(step_ns: int) -> None:
    remote = Remote(jitter=JITTERS["exponential of 5 ms"])
    estimator = followed(remote, 60)
    remote.offset_ns += step_ns
    needed = next(
        count for count in range(200) if estimator.steps or not estimator.add(remote.exchange())
    )
    # Three blocks, and what was left of the one before.
    assert needed <= 4 * 16
    for _ in range(100):
        estimator.add(remote.exchange())
    assert estimator.steps == 1
    assert remote.error_ns(estimator) < 2 * MS


def test_after_a_step_earlier_frames_give_no_skew() -> None:
    remote = Remote(jitter=MODEST)
    estimator = ClockEstimator()
    for step_ns in (0, 15 * MS):
        remote.offset_ns += step_ns
        for _ in range(160):
            exchange = remote.exchange()
            estimator.add(exchange)
            for t_ns in range(exchange.t4_ns, round(remote.local_ns), 5 * MS):
                estimator.add_one_way(remote.now_ns(t_ns) - 20 * MS, t_ns)
    assert estimator.steps == 1
    assert estimator.skew_ppm == pytest.approx(0, abs=1)


@pytest.mark.parametrize("change_ns", [-15 * MS, 60 * MS])
def test_a_route_that_changes_one_way_is_no_step(change_ns: int) -> None:
    remote = Remote(jitter=MODEST)
    estimator = followed(remote, 60)
    remote.extra_request_ns = change_ns
    list(follow(remote, estimator, 60))
    assert estimator.steps == 0
    assert remote.error_ns(estimator) < abs(change_ns) / 2 + 2 * MS


def test_the_uncertainty_grows_while_no_exchange_comes() -> None:
    remote = Remote(jitter=MODEST)
    estimator = followed(remote, 30)
    now_ns = round(remote.local_ns)
    soon_ns, later_ns = (estimator.uncertainty_ns(now_ns + s * S) for s in (1, 60))
    assert later_ns > 2 * soon_ns
    assert abs(estimator.remote_ns(now_ns + 60 * S) - remote.now_ns(now_ns + 60 * S)) < later_ns


int64 = st.integers(-(2**63), 2**63 - 1)


@given(st.lists(st.tuples(int64, int64, int64, st.integers(0, 30 * S)), max_size=80))
def test_arbitrary_replies_are_used_or_refused(replies: list[tuple[int, int, int, int]]) -> None:
    estimator = ClockEstimator()
    local_ns = 0
    for t1_ns, t2_ns, t3_ns, passed_ns in replies:
        local_ns += passed_ns
        estimator.add(ClockExchange(t1_ns, t2_ns, t3_ns, local_ns))
        assert isinstance(estimator.remote_ns(local_ns), int)
        assert estimator.uncertainty_ns(local_ns) >= 0
