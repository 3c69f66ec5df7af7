"""A film that the board of a drive reads, on the drive's own line."""

from collections import Counter
from collections.abc import Sequence
from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from protocol.config.kinds import KindTable
from protocol.config.quantities import Hertz
from pulse_sensors.force_scale import SensorTable
from pulse_sensors.samples import DecodedBlock, DeviceTime, SampleCounter, join_samples

RATE_HZ = 1000.0
# A board's readings are integers of 16 bits.
LARGEST_COUNT = 2**15 - 1


class DriveFilmScene(SensorTable, KindTable):
    """The `feedback` table of kind "drive": the film on an analogue input of the drive's board.

    A reading is the sum of the board's conversions in a millisecond.
    """

    kind: Literal["drive"]
    rate_hz: Annotated[Hertz, Field(ge=RATE_HZ, le=RATE_HZ)] = RATE_HZ
    unit: Literal["counts"] = "counts"

    @model_validator(mode="after")
    def _has_a_zero_that_is_counted(self) -> Self:
        if self.zero > LARGEST_COUNT:
            raise ValueError(
                f"zero = {self.zero:g} is beyond the greatest count of a board, {LARGEST_COUNT}:"
                " give the counts of a reading without a force"
            )
        return self

    def counts_within(self, limit_n: float) -> tuple[float, float]:
        """Return the counts at -limit_n and at +limit_n; a film may count down."""
        per_newton = 1 / (self.newtons_per_count or 1.0)
        pulled, pressed = (
            self.zero + per_newton * (end_n - self.preload_n) for end_n in (-limit_n, limit_n)
        )
        return pulled, pressed


class DriveFilmDecoder:
    """Decoder of a board's readings: number of the millisecond, time in µs, counts. Pure."""

    def __init__(self, period_ns: int) -> None:
        self._period_ns = period_ns
        self.rejected: Counter[str] = Counter()
        self.reset()

    def reset(self) -> None:
        """Start anew with the next readings, for example after the cable was unplugged."""
        self._time = DeviceTime()
        self._counter = SampleCounter(1 << 32, self._period_ns, self.rejected)

    def feed(self, data: Sequence[tuple[int, int, int]]) -> list[DecodedBlock]:
        """Return the readings as blocks; each loss and each restart of the board begins one."""
        samples = []
        for number, time_us, counts in data:
            passed_ns = self._time.since_last_ns(time_us)
            missing = self._counter.missing(number, 1, passed_ns)
            device_ns = self._time.take(time_us)
            samples.append(((float(counts),), device_ns, missing, passed_ns is None))
        return join_samples(samples)
