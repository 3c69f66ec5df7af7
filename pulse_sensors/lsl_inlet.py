"""A Lab Streaming Layer stream as a sensor."""

from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple, Self

from pydantic import Field, model_validator

from protocol.errors import SourceError
from protocol.wire.description import PULSE
from pulse_sensors import library
from pulse_sensors.force_scale import MAX_VALUES
from pulse_sensors.sample_plausibility import is_usable, rate_contradiction
from pulse_sensors.samples import DecodedBlock, join_samples
from pulse_sensors.sensor import SensorScene

Number = Annotated[int, Field(ge=0)]
Numbers = Annotated[tuple[Number, ...], Field(min_length=1, max_length=MAX_VALUES)]
RESOLVE_S = 3.0
WAIT_S = 0.1
BUFFER_S = 10
# Largest valid time; no clock shows more, whatever its epoch.
LARGEST_TIME_S = 1e10


class LslScene(SensorScene):
    """The `source` table of kind "lsl".

    stream: its name. channel: number of the channel in it, from 0. channels: those of several.
    """

    kind: Literal["lsl"]
    stream: Annotated[str, Field(min_length=1)]
    channel: Number = 0
    channels: Numbers | None = None

    @model_validator(mode="after")
    def _has_one_key(self) -> Self:
        if {"channel", "channels"} <= self.given:
            raise ValueError("channel is one, channels are several; give one of the two keys")
        return self

    def device(self, folder: Path) -> "tuple[LslInlet, LslDecoder]":
        """See `SensorScene.device`."""
        return LslInlet(self), LslDecoder(self.numbers)

    @property
    def numbers(self) -> tuple[int, ...]:
        """Numbers of the channels in the stream."""
        return self.channels or (self.channel,)

    @property
    def value_names(self) -> tuple[str, ...]:
        """Names of a sample's values, in order, where the scene gives none."""
        several = self.channels is not None
        return tuple(f"channel {number}" if several else PULSE for number in self.numbers)


class Chunk(NamedTuple):
    """Samples as an inlet returns them: a list of values for each, and their times in s."""

    samples: list[list[float]]
    times_s: list[float]


class LslInlet:
    """Port to one stream, found by its name; see `pulse_sensors.sensor.Port`.

    Raises SourceError without the pylsl package, or without the library that pylsl loads.
    """

    def __init__(self, scene: LslScene) -> None:
        self.name = f"LSL stream {scene.stream}"
        self._scene = scene
        self._lsl = library("pylsl", "an LSL sensor")
        self._inlet: Any = None

    def open(self) -> None:
        """Find the stream. Raises SourceError if stream or channel is missing or does not fit."""
        found = self._lsl.resolve_byprop("name", self._scene.stream, 1, RESOLVE_S)
        if not found:
            raise SourceError(f"{self.name}: not found within {RESOLVE_S:g} s")
        info = found[0]
        reason = rate_contradiction(info.nominal_srate(), self._scene.rate_hz)
        if max(self._scene.numbers) >= info.channel_count():
            reason = f"no channel {max(self._scene.numbers)}; it has {info.channel_count()}"
        if info.channel_format() == self._lsl.cf_string:
            reason = "its samples are text"
        if reason is not None:
            raise SourceError(f"{self.name}: {reason}")
        self._inlet = self._lsl.StreamInlet(info, max_buflen=BUFFER_S, recover=False)

    def read(self) -> Chunk | None:
        """Return the waiting samples; None after 0.1 s. Raises if the stream is lost."""
        first, time_s = self._inlet.pull_sample(timeout=WAIT_S)
        if first is None:
            return None
        samples, times_s = self._inlet.pull_chunk(timeout=0.0)
        return Chunk([first, *samples], [time_s, *times_s])

    def close(self) -> None:
        """Release the stream."""
        if self._inlet is not None:
            self._inlet.close_stream()
            self._inlet = None


class LslDecoder:
    """Decoder of channels of chunks; their times are on the sending host's LSL clock."""

    def __init__(self, channels: Sequence[int]) -> None:
        self._channels = channels
        self.rejected: Counter[str] = Counter()
        self.reset()

    def reset(self) -> None:
        """Start anew, for example after the stream was lost: another host may send it now."""
        self._restarted = True
        self._unreadable = 0

    def feed(self, chunk: Chunk) -> list[DecodedBlock]:
        """Return the chunk as one block, or as several if unusable samples interrupt it."""
        samples = []
        for sample, time_s in zip(chunk.samples, chunk.times_s, strict=True):
            values = [sample[channel] for channel in self._channels]
            if not (all(map(is_usable, values)) and abs(time_s) <= LARGEST_TIME_S):
                self.rejected["not_finite"] += 1
                self._unreadable += 1
                continue
            samples.append((values, round(time_s * 1e9), self._unreadable, self._restarted))
            self._unreadable, self._restarted = 0, False
        return join_samples(samples)
