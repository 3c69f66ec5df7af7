from hypothesis import given
from hypothesis import strategies as st

from protocol.security.budgets import TokenBucket

SECOND_NS = 1_000_000_000


def test_a_burst_passes_and_then_the_rate() -> None:
    bucket = TokenBucket(rate_per_s=10, burst=5)
    assert [bucket.take(0) for _ in range(6)] == [True] * 5 + [False]
    assert not bucket.take(SECOND_NS // 11)
    assert bucket.take(SECOND_NS // 10)
    assert not bucket.take(SECOND_NS // 10)
    # However long it rests, no more than the burst is there.
    assert [bucket.take(100 * SECOND_NS) for _ in range(6)] == [True] * 5 + [False]


@given(
    st.lists(
        st.tuples(st.integers(-SECOND_NS, SECOND_NS), st.floats(0.1, 10)), min_size=1, max_size=200
    )
)
def test_no_more_tokens_than_burst_and_rate_are_taken(steps: list[tuple[int, float]]) -> None:
    bucket = TokenBucket(rate_per_s=10, burst=20)
    now_ns = taken = forward_ns = 0.0
    for step_ns, count in steps:
        now_ns += step_ns
        # A clock that goes back and on again gives its time twice at most.
        forward_ns += max(0, step_ns)
        taken += count if bucket.take(int(now_ns), count) else 0
    assert taken <= 20 + 10 * forward_ns / SECOND_NS + 1e-6
