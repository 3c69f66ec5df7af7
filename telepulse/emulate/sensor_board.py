"""A sensor board: samples by its own crystal, framed, through a USB that batches. Pure."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from sensing_node.sources import Samples
from sensors.binary_frames import FrameEncoder, SampleFormat

# What one count of an integer sample stands for: an int16 reaches 3.2 N.
NEWTONS_PER_COUNT = 1e-4

Encode = Callable[[Sequence[float], int], bytes]
"""Bytes of forces in N, and of the board's micros() at the last of them."""


def binary(sample_format: SampleFormat) -> Encode:
    """Frames of sensors/binary_frames.py. Raises SourceError without the cobs package."""
    encoder = FrameEncoder(sample_format)
    scale = 1.0 if sample_format == "float32" else NEWTONS_PER_COUNT

    def encode(force_n: Sequence[float], last_us: int) -> bytes:
        return encoder.frame([value / scale for value in force_n], last_us)

    return encode


def timed_line(force_n: Sequence[float], last_us: int) -> bytes:
    """One line with the time and a value, as micros() and Serial.println would print them."""
    return b"%d,%.6f\r\n" % (last_us % (1 << 32), force_n[-1])


def line(force_n: Sequence[float], last_us: int) -> bytes:
    """One line with a value."""
    return b"%.6f\r\n" % force_n[-1]


@dataclass(frozen=True, slots=True)
class Habits:
    """How a board and its USB behave.

    skew: by how much its crystal is fast. begins_us: its micros() at the start. frame: samples a
    frame or line. delivery_ns: USB delivers what there is after a quarter of this to all of it,
    at random. noise: share of the bytes that arrive as another.
    """

    frame: int
    skew: float = 0.0
    begins_us: int = 0
    delivery_ns: int = 16_000_000
    noise: float = 0.0
    seed: int = 1


class SensorBoard:
    """Plays a source in real time, as a board would sense and send it."""

    def __init__(self, samples: Samples, encode: Encode, habits: Habits, start_ns: int) -> None:
        self._samples = samples
        self._encode = encode
        self._habits = habits
        self._start_ns = start_ns
        self._rng = np.random.default_rng(habits.seed)
        self.sampled = 0
        self.next_delivery_ns = start_ns
        self._plan()

    @property
    def rate_hz(self) -> float:
        """Samples a second of the board's own clock."""
        return 1e9 / self._samples.period_ns

    def taken_ns(self, number: int) -> int:
        """When sample `number` is taken, on the host's clock."""
        return self._start_ns + round(number * self._samples.period_ns / (1 + self._habits.skew))

    def deliver(self, now_ns: int) -> bytes:
        """What USB delivers by now; called at `next_delivery_ns` or later."""
        parts = []
        last = self.sampled + self._habits.frame - 1
        while self.taken_ns(last) <= now_ns:
            force_n = self._samples.take(self._habits.frame)[:, 0].tolist()
            if not force_n:
                break
            parts.append(self._encode(force_n, self._micros(self.sampled + len(force_n) - 1)))
            self.sampled += len(force_n)
            last += self._habits.frame
        while self.next_delivery_ns <= now_ns:
            self._plan()
        return self._disturbed(b"".join(parts))

    def _plan(self) -> None:
        longest_ns = self._habits.delivery_ns
        self.next_delivery_ns += max(1, round(self._rng.uniform(longest_ns / 4, longest_ns)))

    def _micros(self, number: int) -> int:
        return self._habits.begins_us + number * self._samples.period_ns // 1_000

    def _disturbed(self, data: bytes) -> bytes:
        if not self._habits.noise:
            return data
        noisy = np.frombuffer(data, np.uint8).copy()
        hit = self._rng.random(len(noisy)) < self._habits.noise
        noisy[hit] = self._rng.integers(0, 256, int(hit.sum()))
        return noisy.tobytes()
