import random

import pytest

from protocol.clock.one_way import DeviceClock

MS = 1_000_000
S = 1_000 * MS


class Device:
    """A board whose clock began elsewhere and runs wrong, behind a bus that sends in batches."""

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
        """For so long, how late each sample seems to have been taken, in ms."""
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


def test_it_is_ready_after_half_a_second() -> None:
    device = Device()
    device.run(0.2)
    assert not device.clock.ready
    device.run(0.5)
    assert device.clock.ready


def test_a_stall_of_a_second_moves_nothing() -> None:
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
def test_a_clock_that_jumps_is_followed_and_counted(jump_ns: int) -> None:
    device = Device(80e-6)
    device.run(10)
    device.zero_ns += jump_ns
    device.run(3)
    assert max(map(abs, device.run(5))) < 0.5
    assert device.clock.steps == 1


def test_a_host_that_was_suspended_is_followed() -> None:
    device = Device()
    device.run(10)
    # The host's clock stood still, or the board's lost time: all comes later than ever.
    device.zero_ns -= 3 * S
    device.clock.observe(device.shows_ns(device.now_ns + 4 * S), device.now_ns + 4 * S)
    device.now_ns += 4 * S
    device.run(4)
    assert max(map(abs, device.run(3))) < 0.5
    assert device.clock.steps == 1


def test_one_time_before_its_arrival_is_no_jump() -> None:
    device = Device()
    device.run(10)
    device.clock.observe(device.shows_ns(device.now_ns) + 500 * MS, device.now_ns)
    assert device.clock.steps == 0
    assert abs(device.clock.host_ns(device.shows_ns(device.now_ns)) - device.now_ns) < MS
