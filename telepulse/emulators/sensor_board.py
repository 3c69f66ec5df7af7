"""An emulated sensor board: it samples by its own crystal, and USB delivers frames in batches.

Not modelled: a crystal whose rate changes, lost bytes, control lines, a board that restarts by
itself, the electrical noise of a real front end.
"""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import tomlkit

from protocol.wire.description import PULSE, Channel
from pulse_sensors.binary_frames import FrameEncoder, SampleFormat
from sensing_node.sources.source import SampleSource
from telepulse.emulators import PtyPort

# Force of one count of an integer sample; the range of an int16 is then ±3.2 N.
NEWTONS_PER_COUNT = 1e-4
# Keys of the table that reads such samples.
COUNTS = {"zero": 0, "newtons_per_count": NEWTONS_PER_COUNT, "preload": "0 N"}
# Millivolts in a count of a channel that announces: 1 µV.
MILLIVOLTS_PER_COUNT = 1e-3

Samples = Sequence[Sequence[float]]
Encode = Callable[[Samples, int], bytes]
"""Encodes samples, of each its values, and the board's micros() at the last of them."""
PULSES = (Channel(PULSE),)


def binary(sample_format: SampleFormat, channels: Sequence[Channel] = PULSES) -> Encode:
    """Return the encoder of binary frames."""
    encoder = FrameEncoder(sample_format, len(channels))
    scales = np.ones(len(channels))
    if sample_format != "float32":
        scales *= [MILLIVOLTS_PER_COUNT if c.announces else NEWTONS_PER_COUNT for c in channels]

    def encode(samples: Samples, last_us: int) -> bytes:
        return encoder.frame((np.array(samples) / scales).tolist(), last_us)

    return encode


def timed_line(samples: Samples, last_us: int) -> bytes:
    """Encode one line with time and values, as micros() and Serial.println print them."""
    return b"%d,%b" % (last_us % (1 << 32), line(samples, last_us))


def line(samples: Samples, last_us: int) -> bytes:
    """Encode one line with the values of a sample."""
    return b",".join(b"%.6f" % value for value in samples[-1]) + b"\r\n"


LINES: dict[str, Encode] = {"text": timed_line, "untimed": line}
"""Encoders of the framings that are lines of text."""


@dataclass(frozen=True, slots=True)
class BoardBehaviour:
    """Behaviour of a board and its USB.

    frame: samples in a frame or line. skew: relative error of the crystal; above 0 it is fast.
    begins_us: micros() at the start. delivery_ns: longest time between two deliveries by USB; the
    shortest is a quarter of it. noise: share of the bytes that noise alters.
    """

    frame: int
    skew: float = 0.0
    begins_us: int = 0
    delivery_ns: int = 16_000_000
    noise: float = 0.0
    seed: int = 1


class SensorBoard:
    """Board that sends the samples of a source. Pure: time is an argument."""

    def __init__(
        self, samples: SampleSource, encode: Encode, behaviour: BoardBehaviour, start_ns: int
    ) -> None:
        self._samples, self._encode, self._behaviour = samples, encode, behaviour
        self.channels = samples.channels
        self._start_ns = start_ns
        self._rng = np.random.default_rng(behaviour.seed)
        self.sampled = 0
        self.next_delivery_ns = start_ns
        self._plan_delivery()

    @property
    def rate_hz(self) -> float:
        """Rate of the samples by the board's own clock."""
        return 1e9 / self._samples.period_ns

    def taken_ns(self, number: int) -> int:
        """Return the time of sample `number` on the host's clock."""
        return self._start_ns + round(number * self._samples.period_ns / (1 + self._behaviour.skew))

    def deliver(self, now_ns: int) -> bytes:
        """Return the bytes that USB delivers by now; call it at `next_delivery_ns` or later."""
        parts, frame = [], self._behaviour.frame
        while self.taken_ns(self.sampled + frame - 1) <= now_ns:
            taken = self._samples.take(frame).tolist()
            if not taken:
                break
            self.sampled += len(taken)
            last_ns = (self.sampled - 1) * self._samples.period_ns
            parts.append(self._encode(taken, self._behaviour.begins_us + last_ns // 1_000))
        while self.next_delivery_ns <= now_ns:
            self._plan_delivery()
        noisy = np.frombuffer(b"".join(parts), np.uint8).copy()
        if self._behaviour.noise:
            hit = self._rng.random(len(noisy)) < self._behaviour.noise
            noisy[hit] = self._rng.integers(0, 256, int(hit.sum()))
        return noisy.tobytes()

    def _plan_delivery(self) -> None:
        longest_ns = self._behaviour.delivery_ns
        self.next_delivery_ns += max(1, round(self._rng.uniform(longest_ns / 4, longest_ns)))


def source_table(
    port: Path,
    rate_hz: float,
    framing: str,
    samples: SampleFormat,
    channels: Sequence[Channel] = PULSES,
) -> str:
    """Return the [sensing.source] of a scene that reads the board."""
    source: dict[str, object] = {"kind": "serial", "port": str(port)}
    source["framing"] = "binary" if framing == "binary" else "text"
    if framing == "text":
        source["device_time"] = "us"
    source["rate"] = f"{rate_hz:g} Hz"
    if len(channels) > 1:
        source["names"] = [channel.name for channel in channels]
    if framing == "binary" and samples != "float32":
        # Zero and preload too: the scene may inherit those of an amplifier.
        source |= {"unit": "counts", **COUNTS}
        if any(channel.announces for channel in channels):
            source["announce_unit"] = "uV"
    else:
        source["unit"] = "N"
    return tomlkit.dumps({"sensing": {"source": source}}).rstrip()


def play(board: SensorBoard, port: PtyPort, until_ns: int, stopped: Callable[[], bool]) -> None:
    """Write the board's deliveries until it is stopped, or until a time."""
    while not stopped() and (now_ns := time.perf_counter_ns()) < until_ns:
        wait_ns = min(board.next_delivery_ns, until_ns) - now_ns
        if wait_ns > 0:
            time.sleep(min(wait_ns * 1e-9, 0.1))
        if time.perf_counter_ns() >= board.next_delivery_ns:
            port.write(board.deliver(time.perf_counter_ns()))
