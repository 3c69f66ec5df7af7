import random

import pytest

from protocol.clock.estimator import ClockEstimator, ClockExchange
from protocol.clock.one_way import DeviceClock

MS = 1_000_000
S = 1_000 * MS
EVERY_NS = 5 * MS


def arrivals(count: int, jitter_ms: float = 0.0, seed: int = 1) -> list[tuple[int, int]]:
    """Return the times of sending and arrival of each message, by one clock."""
    rng = random.Random(seed)
    sent_ns = range(0, count * EVERY_NS, EVERY_NS)
    return [(t_ns, t_ns + 20 * MS + round(abs(rng.gauss(0, jitter_ms)) * MS)) for t_ns in sent_ns]


def shown_ns(local_ns: int, skew_ppm: float) -> int:
    return local_ns + 3_600 * S + round(local_ns * skew_ppm * 1e-6)


def followed(frame_skew_ppm: float | None, late_ns: int = 0) -> ClockEstimator:
    """Return an estimator after a minute of a clock that is 100 ppm fast.

    In the second half of the minute, frames take `late_ns` longer.
    """
    estimator, rng = ClockEstimator(), random.Random(4)
    for number, (sent_ns, arrived_ns) in enumerate(arrivals(12_000, 3)):
        if number % 4 == 0:
            there_ns, back_ns = (round(20 * MS + rng.gauss(0, 3 * MS)) for _ in range(2))
            remote_ns = shown_ns(sent_ns + there_ns, 100)
            local_ns = sent_ns + there_ns + back_ns
            estimator.add(ClockExchange(sent_ns, remote_ns, remote_ns, local_ns))
        if frame_skew_ppm is not None:
            later_ns = late_ns if sent_ns > 30 * S else 0
            estimator.add_one_way(shown_ns(sent_ns, frame_skew_ppm), arrived_ns + later_ns)
    return estimator


def test_frames_that_agree_reduce_the_uncertainty() -> None:
    alone, together = followed(None), followed(100)
    assert together.uncertainty_ns(60 * S) < 0.85 * alone.uncertainty_ns(60 * S)
    assert together.skew_ppm == pytest.approx(100, abs=5)


@pytest.mark.parametrize(("frame_skew_ppm", "late_ns"), [(0, 0), (600, 0), (100, 60 * MS)])
def test_contradicting_frames_change_little(frame_skew_ppm: float, late_ns: int) -> None:
    alone, together = followed(None), followed(frame_skew_ppm, late_ns)
    assert together.skew_ppm == pytest.approx(alone.skew_ppm, abs=0.5)
    assert abs(together.offset_ns(60 * S) - alone.offset_ns(60 * S)) < 0.02 * MS


class Device:
    """A board whose clock has an offset and a skew, behind a bus that sends in batches."""

    def __init__(self, skew: float = 0.0, rate_hz: int = 500, batch_ms: float = 16.0) -> None:
        self.skew = skew
        self.period_ns = S // rate_hz
        self.batch_ns = batch_ms * MS
        self.zero_ns = 7 * S
        self.random = random.Random(1)
        self.now_ns = 100 * S
        self.clock = DeviceClock()

    def shows_ns(self, host_ns: int) -> int:
        return round((host_ns - 100 * S) * (1 + self.skew)) + self.zero_ns

    def run(self, seconds: float) -> list[float]:
        """Sample for some seconds; return the error of each sample's estimated time, in ms."""
        end_ns, waiting, late_ms = self.now_ns + seconds * S, [], []
        next_batch_ns: float = self.now_ns
        while self.now_ns < end_ns:
            waiting.append(self.now_ns)
            if self.now_ns >= next_batch_ns:
                next_batch_ns = self.now_ns + self.random.uniform(0.25, 1) * self.batch_ns
                arrival_ns = self.now_ns + round(self.random.expovariate(1 / (0.2 * MS)))
                for taken_ns in waiting:
                    self.clock.observe(self.shows_ns(taken_ns), arrival_ns)
                    host_ns = self.clock.host_ns(self.shows_ns(taken_ns))
                    late_ms.append((host_ns - taken_ns) / MS)
                waiting.clear()
            self.now_ns += self.period_ns
        return late_ms


@pytest.mark.parametrize("skew_ppm", [-5000, 0, 80])
def test_batching_does_not_jitter_the_times(skew_ppm: int) -> None:
    device = Device(skew_ppm * 1e-6)
    device.run(2)
    late_ms = device.run(30)
    assert max(late_ms) - min(late_ms) < 0.3
    assert max(map(abs, late_ms)) < 0.5
    assert device.clock.skew_ppm == pytest.approx(skew_ppm, abs=2)
    assert device.clock.steps == 0


def test_a_stall_of_a_second_changes_nothing() -> None:
    device = Device(80e-6)
    device.run(10)
    held_ns = device.now_ns
    for sample in range(500):
        device.clock.observe(device.shows_ns(held_ns + sample * 2 * MS), held_ns + S)
    device.now_ns = held_ns + S
    late_ms = device.run(5)
    assert max(map(abs, late_ms)) < 0.5
    assert device.clock.steps == 0


@pytest.mark.parametrize("jump_ns", [-5 * S, 50 * MS, 3600 * S], ids=["anew", "50 ms", "1 h"])
def test_a_step_of_the_clock_is_followed_and_counted(jump_ns: int) -> None:
    device = Device(80e-6)
    device.run(10)
    device.zero_ns += jump_ns
    device.run(3)
    assert max(map(abs, device.run(5))) < 0.5
    assert device.clock.steps == 1


def test_a_suspended_host_is_followed() -> None:
    device = Device()
    device.run(10)
    # The host's clock was stopped, or the board lost time: everything arrives later than before.
    device.zero_ns -= 3 * S
    device.clock.observe(device.shows_ns(device.now_ns + 4 * S), device.now_ns + 4 * S)
    device.now_ns += 4 * S
    device.run(4)
    assert max(map(abs, device.run(3))) < 0.5
    assert device.clock.steps == 1


def test_half_a_second_makes_it_ready_and_one_early_arrival_is_no_step() -> None:
    device = Device()
    device.run(0.2)
    assert not device.clock.ready
    device.run(0.5)
    assert device.clock.ready
    device.run(10)
    device.clock.observe(device.shows_ns(device.now_ns) + 500 * MS, device.now_ns)
    assert device.clock.steps == 0
    assert abs(device.clock.host_ns(device.shows_ns(device.now_ns)) - device.now_ns) < MS
