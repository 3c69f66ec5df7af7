"""Lies of an emulated drive: what is false between its motor, its bus and the film. Pure.

A lie is a fault that nothing reports: the drive goes on answering. Supervision has to find it.
"""

import random
from collections import deque
from dataclasses import dataclass
from enum import Enum
from typing import NamedTuple

from protocol.config.quantities import parse_quantity, parse_ratio
from protocol.errors import SceneError


class SizeRange(NamedTuple):
    """How large a lie may be: the dimension of its quantity, bounds and default, as text."""

    dimension: str
    least: str
    most: str
    usual: str


class FaultKind(Enum):
    """What is false. "-encoder": the reported position is the shaft's, not the commanded one."""

    REVERSED = "reversed"
    REVERSED_ENCODER = "reversed-encoder"
    GAIN = "gain"
    GAIN_ENCODER = "gain-encoder"
    NO_RETRACTION = "no-retraction"
    POSITION_FROZEN = "position-frozen"
    POSITION_JUMP = "position-jump"
    POSITION_DRIFT = "position-drift"
    POSITION_NOISE = "position-noise"
    DELAYED = "delayed"
    LOST = "lost"
    DUPLICATED = "duplicated"
    GARBAGE = "garbage"
    FILM_ZERO = "film-zero"
    FILM_FROZEN = "film-frozen"
    FILM_SCALED = "film-scaled"
    FILM_NOISE = "film-noise"
    FILM_LATE = "film-late"


_RATIO = "ratio"
SIZES: dict[FaultKind, SizeRange] = {
    FaultKind.GAIN: SizeRange(_RATIO, "0.3", "3", "2"),
    FaultKind.GAIN_ENCODER: SizeRange(_RATIO, "0.3", "3", "2"),
    FaultKind.POSITION_JUMP: SizeRange("length", "-10 mm", "10 mm", "0.5 mm"),
    FaultKind.POSITION_DRIFT: SizeRange("speed", "-10 mm/s", "10 mm/s", "1 mm/s"),
    FaultKind.POSITION_NOISE: SizeRange("length", "0 mm", "10 mm", "50 µm"),
    FaultKind.DELAYED: SizeRange("time", "0 ms", "1 s", "30 ms"),
    FaultKind.LOST: SizeRange(_RATIO, "0", "1", "0.3"),
    FaultKind.DUPLICATED: SizeRange(_RATIO, "0", "1", "1"),
    FaultKind.GARBAGE: SizeRange(_RATIO, "0", "1", "0.3"),
    FaultKind.FILM_SCALED: SizeRange(_RATIO, "-10", "10", "0.5"),
    FaultKind.FILM_NOISE: SizeRange("force", "0 N", "10 N", "0.2 N"),
    FaultKind.FILM_LATE: SizeRange("time", "0 ms", "1 s", "60 ms"),
}
_REVERSED = (FaultKind.REVERSED, FaultKind.REVERSED_ENCODER)
_ENCODER = (FaultKind.REVERSED_ENCODER, FaultKind.GAIN_ENCODER)
_GAIN = (FaultKind.GAIN, FaultKind.GAIN_ENCODER)


@dataclass(frozen=True, slots=True)
class InjectedFault:
    """One lie. size: in the SI unit of its kind's dimension; a share or factor without one."""

    kind: FaultKind
    size: float = 0.0

    @property
    def motion(self) -> float:
        """Steps that the shaft turns for each step commanded."""
        if self.kind in _REVERSED:
            return -1.0
        return self.size if self.kind in _GAIN else 1.0

    @property
    def by_encoder(self) -> bool:
        """Whether the drive counts what the shaft does instead of what it commands."""
        return self.kind in _ENCODER


def parse_fault(kind: FaultKind, size: str | None) -> InjectedFault:
    """Make a lie of its kind and size as a person writes them ("30 ms").

    Raises SceneError where the kind has no size, or for a size that does not fit.
    """
    allowed = SIZES.get(kind)
    if allowed is None:
        if size is not None:
            raise SceneError(f"--size: {kind.value} has none")
        return InjectedFault(kind)
    try:
        value, least, most = (
            _number(text, allowed.dimension)
            for text in (size or allowed.usual, allowed.least, allowed.most)
        )
    except ValueError as error:
        raise SceneError(f"--size: {error}") from None
    if not least <= value <= most:
        raise SceneError(
            f"--size: {kind.value} takes {allowed.least} to {allowed.most}, not {size}"
        )
    return InjectedFault(kind, value)


def _number(text: str, dimension: str) -> float:
    return parse_ratio(text) if dimension == _RATIO else parse_quantity(text, dimension)


class FaultInjector:
    """Applies one lie between a motor, its bus and the film, from `begin` on.

    step_m: travel of one step. lie: the one that is applied; None before `begin`.
    """

    def __init__(self, step_m: float, seed: int = 1) -> None:
        self._step_m = step_m
        self._chance = random.Random(seed)
        self._begun_ns = 0
        self._frozen_steps: int | None = None
        self._frozen_n: float | None = None
        self._answers: deque[tuple[int, bytes]] = deque()
        self.lie: InjectedFault | None = None

    def begin(self, lie: InjectedFault, now_ns: int) -> None:
        """Apply a lie from now on."""
        self.lie, self._begun_ns = lie, now_ns
        self._frozen_steps = self._frozen_n = None

    @property
    def motion(self) -> float:
        """Steps that the shaft turns for each step commanded."""
        return self.lie.motion if self.lie is not None else 1.0

    @property
    def by_encoder(self) -> bool:
        """Whether the drive counts what the shaft does instead of what it commands."""
        return self.lie is not None and self.lie.by_encoder

    def obeyed_hz(self, rate_hz: float) -> float:
        """Return the step rate that is obeyed for a commanded one, positive into the finger."""
        if self.lie is not None and self.lie.kind is FaultKind.NO_RETRACTION:
            return max(0.0, rate_hz)
        return rate_hz

    def position_steps(self, steps: int, now_ns: int) -> int:
        """Return the position that the bus reports for the counter's."""
        if self.lie is None:
            return steps
        size_steps = self.lie.size / self._step_m
        match self.lie.kind:
            case FaultKind.POSITION_FROZEN:
                if self._frozen_steps is None:
                    self._frozen_steps = steps
                return self._frozen_steps
            case FaultKind.POSITION_JUMP:
                return steps + round(size_steps)
            case FaultKind.POSITION_DRIFT:
                return steps + round(size_steps * (now_ns - self._begun_ns) * 1e-9)
            case FaultKind.POSITION_NOISE:
                return steps + round(self._chance.gauss(0.0, size_steps))
        return steps

    def film_n(self, force_n: float) -> float:
        """Return the force that the film's sensor sends for the one under the finger, in N."""
        if self.lie is None:
            return force_n
        match self.lie.kind:
            case FaultKind.FILM_ZERO:
                return 0.0
            case FaultKind.FILM_FROZEN:
                if self._frozen_n is None:
                    self._frozen_n = force_n
                return self._frozen_n
            case FaultKind.FILM_SCALED:
                return self.lie.size * force_n
            case FaultKind.FILM_NOISE:
                return force_n + self._chance.gauss(0.0, self.lie.size)
        return force_n

    @property
    def film_late_ns(self) -> int:
        """How much later than usual the film's samples are sent."""
        if self.lie is None or self.lie.kind is not FaultKind.FILM_LATE:
            return 0
        return round(self.lie.size * 1e9)

    def answer(self, data: bytes, now_ns: int, header: int = 0) -> None:
        """Take an answer of the drive, to be sent when it is due.

        header: bytes at the beginning that garbage spares, such as an identifier.
        """
        lie = self.lie or InjectedFault(FaultKind.DELAYED, 0.0)
        if lie.kind is FaultKind.DELAYED:
            self._answers.append((now_ns + round(lie.size * 1e9), data))
            return
        hit = self._chance.random() < lie.size
        if lie.kind is FaultKind.LOST and hit:
            return
        if lie.kind is FaultKind.GARBAGE and hit:
            data = data[:header] + self._chance.randbytes(len(data) - header)
        self._answers.append((now_ns, data))
        if lie.kind is FaultKind.DUPLICATED and hit:
            self._answers.append((now_ns, data))

    def due(self, now_ns: int) -> list[bytes]:
        """Return the answers that are to be sent by now, in their order."""
        sent = []
        while self._answers and self._answers[0][0] <= now_ns:
            sent.append(self._answers.popleft()[1])
        return sent
