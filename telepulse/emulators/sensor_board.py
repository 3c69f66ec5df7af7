"""A sensor board: samples by its own crystal, framed, through a USB that batches. Pure.

`telepulse emulate sensor`: a sensor board on a pseudo-terminal, in real time.
"""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from pulse_sensors.binary_frames import FrameEncoder, SampleFormat
from sensing_node.scene import SensingScene, build_source
from sensing_node.sources import SampleSource
from telepulse.emulators.pty_port import PtyPort

# What one count of an integer sample stands for: an int16 reaches 3.2 N.
NEWTONS_PER_COUNT = 1e-4

Encode = Callable[[Sequence[float], int], bytes]
"""Bytes of forces in N, and of the board's micros() at the last of them."""


def binary(sample_format: SampleFormat) -> Encode:
    """Frames of pulse_sensors/binary_frames.py. Raises SourceError without the cobs package."""
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
class BoardBehaviour:
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

    def __init__(
        self, samples: SampleSource, encode: Encode, habits: BoardBehaviour, start_ns: int
    ) -> None:
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


LINES = {"text": timed_line, "untimed": line}


def build_board(
    scene: SensingScene, folder: Path, framing: str, samples: SampleFormat, habits: BoardBehaviour
) -> SensorBoard:
    """A board that plays the scene's source from now on; framing: "text", "untimed", "binary".

    Raises SceneError or SourceError.
    """
    # A real board sends what it has, plausible or not.
    source = build_source(scene, folder, plausible=False)
    encode = binary(samples) if framing == "binary" else LINES[framing]
    return SensorBoard(source, encode, habits, time.monotonic_ns())


def source_table(port: Path, rate_hz: float, framing: str, samples: SampleFormat) -> str:
    """The [sensing.source] of a scene that reads the board."""
    unit = ['unit = "N"']
    if framing == "binary" and samples != "float32":
        unit = ['unit = "counts"', f"newtons_per_count = {NEWTONS_PER_COUNT:g}"]
    lines = [
        "[sensing.source]",
        'kind = "serial"',
        f'port = "{port}"',
        f'framing = "{"binary" if framing == "binary" else "text"}"',
        *(['device_time = "us"'] if framing == "text" else []),
        f'rate = "{rate_hz:g} Hz"',
        *unit,
    ]
    return "\n".join(lines)


def play(board: SensorBoard, port: PtyPort, until_ns: int, stopped: Callable[[], bool]) -> None:
    """Write what the board sends until it is stopped, or then."""
    while not stopped() and (now_ns := time.monotonic_ns()) < until_ns:
        wait_ns = min(board.next_delivery_ns, until_ns) - now_ns
        if wait_ns > 0:
            time.sleep(min(wait_ns * 1e-9, 0.1))
        if time.monotonic_ns() >= board.next_delivery_ns:
            port.write(board.deliver(time.monotonic_ns()))
