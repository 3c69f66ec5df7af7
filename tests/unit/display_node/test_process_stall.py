"""A display whose process stalls, in virtual time: the pulse returns by a ramp.

The frames of the stall have queued; they arrive at once, gradually, or not at all.
"""

from collections.abc import Iterator

import numpy as np
import pytest

from display_node.node import LEAST_READ
from tests.support.sender import MS, Sender, display, run

BEGIN_MS, FORCE_N = 1_500, 0.3
# The scene's: stale_after, fade and ramp.
STALE_MS, FADE_MS, RAMP_MS = 60, 40, 300
STALLS_MS = (50, 60, 70, 100, 250, 400, 1_000, 2_600, 5_000)
ALL_AT_ONCE = 10_000


def played_after(stall_ms: int, read_a_tick: int, cut_ms: int = 0) -> Iterator[tuple[float, float]]:
    """Stall a display that plays; yield gain and felt force of each tick of the next second.

    read_a_tick: number of messages received before each tick. cut_ms: where above 0, the stall
    loses the connection with its queue, and a new one is open after this time.
    """
    under_test, sender = display(), Sender()
    run(under_test, sender, 0, BEGIN_MS, FORCE_N)
    assert under_test.state == "playing"
    over_ms = BEGIN_MS + stall_ms
    stall = range(BEGIN_MS, over_ms)
    queue = [sender.frame(ms * MS, FORCE_N) for ms in stall if ms % 5 == 0]
    if cut_ms:
        queue.clear()
    for ms in range(over_ms, over_ms + 1_000):
        if ms % 5 == 0 and ms >= over_ms + cut_ms:
            queue.append(sender.frame(ms * MS, FORCE_N))
        for frame in queue[:read_a_tick]:
            under_test.on_frame(frame, ms * MS)
        queue = queue[read_a_tick:]
        felt_n = under_test.tick(ms * MS, stall_ms if ms == over_ms else 1).felt_n
        yield under_test.fade.gain, felt_n
        sender.serve(under_test, ms * MS)


@pytest.mark.parametrize("stall_ms", STALLS_MS)
@pytest.mark.parametrize(
    ("read_a_tick", "cut_ms"), [(ALL_AT_ONCE, 0), (LEAST_READ + 1, 0), (ALL_AT_ONCE, 50)]
)
def test_the_pulse_returns_by_a_ramp_after_a_stall_beyond_the_stale_limit(
    stall_ms: int, read_a_tick: int, cut_ms: int
) -> None:
    gains, felt_n = np.array(list(played_after(stall_ms, read_a_tick, cut_ms))).T
    faded = min(1.0, max(0.0, (stall_ms - STALE_MS) / FADE_MS))
    # The queue makes neither the fade slower nor the ramp faster.
    assert gains[0] <= 1.0 - faded + 1.0 / RAMP_MS + 1e-9
    assert np.diff(gains).max() <= 1.0 / RAMP_MS + 1e-9
    if faded == 1.0:
        assert np.flatnonzero(gains == 1.0)[0] >= RAMP_MS - 2
        assert felt_n.min() < 0.4 * FORCE_N
    assert gains[-1] == 1.0
    assert felt_n[-1] == pytest.approx(FORCE_N, abs=5e-3)


def test_a_stall_within_the_stale_limit_is_not_an_interruption() -> None:
    gains = [gain for gain, _ in played_after(STALE_MS, ALL_AT_ONCE)]
    assert gains == [1.0] * len(gains)
