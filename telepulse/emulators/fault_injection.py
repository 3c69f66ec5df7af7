"""Faults injected between an emulated drive's motor, its bus and the film. Pure.

Nothing reports such a fault: the drive goes on answering, and supervision has to find it. Not
modelled: two faults at once, faults that come and go.
"""

import random
from collections import deque
from dataclasses import dataclass
from enum import Enum
from typing import NamedTuple

from protocol.config.quantities import parse_quantity, parse_ratio
from protocol.errors import SceneError


class SizeRange(NamedTuple):
    """Size that a fault may have: dimension, bounds and default, as text."""

    dimension: str
    least: str
    most: str
    default: str


class FaultKind(Enum):
    """The wrong quantity. "-encoder": the reported position is the shaft's, not the command's."""

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


@dataclass(frozen=True, slots=True)
class InjectedFault:
    """One fault. size: in the SI unit of its kind's dimension; a share or factor without one."""

    kind: FaultKind
    size: float = 0.0


def parse_fault(kind: FaultKind, size: str | None) -> InjectedFault:
    """Return the fault of a kind and a size such as "30 ms"; None: its default size.

    Raises SceneError where the kind has no size, or for a size that does not fit.
    """
    allowed = SIZES.get(kind)
    if allowed is None:
        if size is not None:
            raise SceneError(f"--size: {kind.value} has none")
        return InjectedFault(kind)
    try:
        value, least, most = (
            parse_ratio(text)
            if allowed.dimension == _RATIO
            else parse_quantity(text, allowed.dimension)
            for text in (size or allowed.default, allowed.least, allowed.most)
        )
    except ValueError as error:
        raise SceneError(f"--size: {error}") from None
    if not least <= value <= most:
        raise SceneError(
            f"--size: {kind.value} takes {allowed.least} to {allowed.most}, not {size}"
        )
    return InjectedFault(kind, value)


class FaultInjector:
    """Applies one fault between a motor, its bus and the film, from `begin` on.

    Parameters
    ----------
    step_m : float
        Travel of one step.
    """

    def __init__(self, step_m: float, seed: int = 1) -> None:
        self._step_m = step_m
        self._random = random.Random(seed)
        self._begun_ns = 0
        self._frozen_steps: int | None = None
        self._frozen_n: float | None = None
        self._answers: deque[tuple[int, bytes]] = deque()
        self._kind: FaultKind | None = None
        self._size = 0.0

    def begin(self, fault: InjectedFault, now_ns: int) -> None:
        """Apply a fault from now on."""
        self._kind, self._size, self._begun_ns = fault.kind, fault.size, now_ns
        self._frozen_steps = self._frozen_n = None

    @property
    def motion_ratio(self) -> float:
        """Steps that the shaft turns for each commanded step."""
        if self._kind in (FaultKind.REVERSED, FaultKind.REVERSED_ENCODER):
            return -1.0
        return self._size if self._kind in (FaultKind.GAIN, FaultKind.GAIN_ENCODER) else 1.0

    @property
    def counts_shaft(self) -> bool:
        """True where the drive counts the shaft's steps instead of the commanded ones."""
        return self._kind in (FaultKind.REVERSED_ENCODER, FaultKind.GAIN_ENCODER)

    def executed_hz(self, rate_hz: float) -> float:
        """Return the step rate executed for a commanded one, positive into the finger."""
        return max(0.0, rate_hz) if self._kind is FaultKind.NO_RETRACTION else rate_hz

    def position_steps(self, steps: int, now_ns: int) -> int:
        """Return the position that the bus reports for the counter's."""
        size_steps = self._size / self._step_m
        match self._kind:
            case FaultKind.POSITION_FROZEN:
                self._frozen_steps = steps if self._frozen_steps is None else self._frozen_steps
                return self._frozen_steps
            case FaultKind.POSITION_JUMP:
                return steps + round(size_steps)
            case FaultKind.POSITION_DRIFT:
                return steps + round(size_steps * (now_ns - self._begun_ns) * 1e-9)
            case FaultKind.POSITION_NOISE:
                return steps + round(self._random.gauss(0.0, size_steps))
        return steps

    def film_n(self, force_n: float) -> float:
        """Return the force that the film's sensor sends for the force under the finger, in N."""
        match self._kind:
            case FaultKind.FILM_ZERO:
                return 0.0
            case FaultKind.FILM_FROZEN:
                self._frozen_n = force_n if self._frozen_n is None else self._frozen_n
                return self._frozen_n
            case FaultKind.FILM_SCALED:
                return self._size * force_n
            case FaultKind.FILM_NOISE:
                return force_n + self._random.gauss(0.0, self._size)
        return force_n

    @property
    def film_delay_ns(self) -> int:
        """Additional delay of the film's samples."""
        return round(self._size * 1e9) if self._kind is FaultKind.FILM_LATE else 0

    def queue_answer(self, data: bytes, now_ns: int, header: int = 0) -> None:
        """Queue an answer of the drive, to be sent when it is due.

        header: length of the beginning that garbage leaves as it is, such as an identifier.
        """
        if self._kind is None or self._kind is FaultKind.DELAYED:
            self._answers.append((now_ns + round(self._size * 1e9), data))
            return
        hit = self._random.random() < self._size
        if self._kind is FaultKind.LOST and hit:
            return
        if self._kind is FaultKind.GARBAGE and hit:
            data = data[:header] + self._random.randbytes(len(data) - header)
        self._answers.append((now_ns, data))
        if self._kind is FaultKind.DUPLICATED and hit:
            self._answers.append((now_ns, data))

    def due_answers(self, now_ns: int) -> list[bytes]:
        """Return the answers that are to be sent by now, in their order."""
        due = []
        while self._answers and self._answers[0][0] <= now_ns:
            due.append(self._answers.popleft()[1])
        return due
