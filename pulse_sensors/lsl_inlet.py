"""A Lab Streaming Layer stream as a sensor."""

from collections import Counter
from typing import Annotated, Any, Literal, NamedTuple

from pydantic import Field

from protocol.errors import SourceError
from pulse_sensors.extra import library
from pulse_sensors.force_scale import SensorTable
from pulse_sensors.reading import LARGEST, Packet

RESOLVE_S = 3.0
WAIT_S = 0.1
BUFFER_S = 10
RATE_TOLERANCE = 0.1
# No clock says more, in whatever year it began.
LARGEST_TIME_S = 1e10


class LslScene(SensorTable):
    """The `source` table of kind "lsl": the stream's name, and which of its channels, from 0."""

    kind: Literal["lsl"]
    stream: Annotated[str, Field(min_length=1)]
    channel: Annotated[int, Field(ge=0)] = 0


class Chunk(NamedTuple):
    """Samples as an inlet gives them: a list of values each, and their times in s."""

    samples: list[list[float]]
    times_s: list[float]


class LslInlet:
    """Chunks of one stream, found by its name."""

    def __init__(self, scene: LslScene) -> None:
        """Raise SourceError without the pylsl package, or the library that it loads."""
        self.name = f"LSL stream {scene.stream}"
        self._scene = scene
        self._lsl = library("pylsl", "an LSL sensor")
        self._inlet: Any = None

    def open(self) -> None:
        """Find the stream. Raises SourceError when it, its channel or its rate is not there."""
        found = self._lsl.resolve_byprop("name", self._scene.stream, 1, RESOLVE_S)
        if not found:
            raise SourceError(f"{self.name}: not found within {RESOLVE_S:g} s")
        info = found[0]
        if info.channel_format() == self._lsl.cf_string:
            raise SourceError(f"{self.name}: its samples are text")
        if self._scene.channel >= info.channel_count():
            raise SourceError(
                f"{self.name}: no channel {self._scene.channel}; it has {info.channel_count()}"
            )
        rate_hz = info.nominal_srate()
        if rate_hz and abs(self._scene.rate_hz / rate_hz - 1) > RATE_TOLERANCE:
            raise SourceError(
                f"{self.name}: its rate is {rate_hz:g} Hz, the scene says {self._scene.rate_hz:g}"
            )
        self._inlet = self._lsl.StreamInlet(info, max_buflen=BUFFER_S, recover=False)

    def read(self) -> Chunk | None:
        """Return what has come, or None after 0.1 s. Raises when the stream is lost."""
        first, time_s = self._inlet.pull_sample(timeout=WAIT_S)
        if first is None:
            return None
        samples, times_s = self._inlet.pull_chunk(timeout=0.0)
        return Chunk([first, *samples], [time_s, *times_s])

    def close(self) -> None:
        """Let go of the stream."""
        if self._inlet is not None:
            self._inlet.close_stream()
            self._inlet = None


class LslDecoder:
    """The channel's values in chunks; their time is the sending host's LSL clock."""

    def __init__(self, channel: int) -> None:
        self._channel = channel
        self.rejected: Counter[str] = Counter()
        self.reset()

    def reset(self) -> None:
        """Begin anew, as after the stream was lost: another host may send it now."""
        self._anew = True
        self._spoilt = 0

    def feed(self, chunk: Chunk) -> list[Packet]:
        """Return the chunk as one packet, or as several around samples that are no numbers."""
        packets: list[Packet] = []
        run: list[float] = []
        for position, sample in enumerate(chunk.samples):
            value, time_s = sample[self._channel], chunk.times_s[position]
            if abs(value) <= LARGEST and abs(time_s) <= LARGEST_TIME_S:
                run.append(value)
                continue
            packets += self._packet(run, chunk.times_s[position - 1])
            run = []
            self.rejected["not_finite"] += 1
            self._spoilt += 1
        return packets + self._packet(run, chunk.times_s[-1])

    def _packet(self, run: list[float], last_s: float) -> list[Packet]:
        if not run:
            return []
        packet = Packet(tuple(run), round(last_s * 1e9), self._spoilt, self._anew)
        self._spoilt, self._anew = 0, False
        return [packet]
