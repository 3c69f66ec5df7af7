"""Emulated drives with injected faults between their motor, their bus and the film.

The drive does not report such a fault and continues to answer: supervision has to detect it. Not
modelled: two faults at once, intermittent faults.
"""

import random
import struct
import time
from collections import deque
from dataclasses import dataclass
from enum import Enum

import can
import canopen

from display_node.plant.contact import ContactLaw
from display_node.plant.scene import StepperScene
from protocol.config.quantities import parse_quantity, parse_ratio
from pulse_drives.stepdir.frames import (
    BoardGreeting,
    BoardState,
    board_reader,
    decode_report,
    encode_report,
)
from pulse_drives.stepdir.scene import StepdirScene
from pulse_sensors.drive_film import DriveFilmScene
from telepulse.emulators.cia402 import EmulatedCia402Node
from telepulse.emulators.motor import TICK_NS, EmulatedMotor
from telepulse.emulators.stepdir import EmulatedBoard, amplifier
from telepulse.emulators.tmcl import EmulatedTmclModule

_RATIO = "ratio"
_IDENTIFIER = struct.Struct(">H")


class FaultKind(Enum):
    """A kind of fault; size: dimension and default of its size, as text; empty where it has none.

    A motor turns the wrong way, by a factor, or not back; the position that it reports is wrong, or
    with "-encoder" that of the shaft; its answers come late, twice, garbled or not at all; the film
    reads 0 N, a constant, a multiple or noise, or is late.
    """

    size: tuple[str, ...]

    def __new__(cls, name: str, *size: str) -> "FaultKind":
        """Create a member whose value is the fault's name."""
        kind = object.__new__(cls)
        kind._value_, kind.size = name, size
        return kind

    REVERSED = "reversed"
    REVERSED_ENCODER = "reversed-encoder"
    GAIN = "gain", _RATIO, "2"
    GAIN_ENCODER = "gain-encoder", _RATIO, "2"
    NO_RETRACTION = "no-retraction"
    POSITION_FROZEN = "position-frozen"
    POSITION_JUMP = "position-jump", "length", "0.5 mm"
    POSITION_DRIFT = "position-drift", "speed", "1 mm/s"
    POSITION_NOISE = "position-noise", "length", "50 µm"
    DELAYED = "delayed", "time", "30 ms"
    LOST = "lost", _RATIO, "0.3"
    DUPLICATED = "duplicated", _RATIO, "1"
    GARBAGE = "garbage", _RATIO, "0.3"
    FILM_ZERO = "film-zero"
    FILM_FROZEN = "film-frozen"
    FILM_SCALED = "film-scaled", _RATIO, "0.5"
    FILM_NOISE = "film-noise", "force", "0.2 N"
    FILM_LATE = "film-late", "time", "60 ms"


@dataclass(frozen=True, slots=True)
class InjectedFault:
    """One fault. size: in SI units, or a share or factor, as its kind requires."""

    kind: FaultKind
    size: float = 0.0


def parse_fault(kind: FaultKind, size: str | None) -> InjectedFault:
    """Return the fault of a kind and a size such as "30 ms"; None: its default size."""
    if not kind.size:
        assert size is None, f"{kind.value} has no size"
        return InjectedFault(kind)
    dimension, default = kind.size
    if dimension == _RATIO:
        return InjectedFault(kind, parse_ratio(size or default))
    return InjectedFault(kind, parse_quantity(size or default, dimension))


class FaultInjector:
    """Injector of one fault between a motor with steps of step_m, its bus and the film."""

    def __init__(self, step_m: float) -> None:
        self._step_m, self._random = step_m, random.Random(1)
        self._kind: FaultKind | None = None
        self._size, self._begun_ns = 0.0, 0
        self._frozen: float | None = None
        self._answers: deque[tuple[int, bytes]] = deque()

    def begin(self, fault: InjectedFault, now_ns: int) -> None:
        """Apply a fault from now on."""
        self._kind, self._size, self._begun_ns = fault.kind, fault.size, now_ns
        self._frozen = None

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
        """Return the position to report on the bus for a counter of `steps`."""
        size_steps = self._size / self._step_m
        match self._kind:
            case FaultKind.POSITION_FROZEN:
                self._frozen = steps if self._frozen is None else self._frozen
                return int(self._frozen)
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
                self._frozen = force_n if self._frozen is None else self._frozen
                return self._frozen
            case FaultKind.FILM_SCALED:
                return self._size * force_n
            case FaultKind.FILM_NOISE:
                return force_n + self._random.gauss(0.0, self._size)
        return force_n

    @property
    def spoils_film(self) -> bool:
        """True while the film's readings are false or late."""
        return self._kind is not None and self._kind.value.startswith("film-")

    @property
    def film_delay_ns(self) -> int:
        """Additional delay of the film's samples."""
        return round(self._size * 1e9) if self._kind is FaultKind.FILM_LATE else 0

    def queue_answer(self, data: bytes, now_ns: int, header: int = 0) -> None:
        """Queue an answer of the drive, to be sent when it is due.

        header: number of leading bytes that garbage leaves unchanged, such as an identifier.
        """
        delayed = self._kind in (None, FaultKind.DELAYED)
        hit = not delayed and self._random.random() < self._size
        due_ns = now_ns + (round(self._size * 1e9) if delayed else 0)
        if hit and self._kind is FaultKind.GARBAGE:
            data = data[:header] + self._random.randbytes(len(data) - header)
        copies: dict[FaultKind | None, int] = {FaultKind.LOST: 0, FaultKind.DUPLICATED: 2}
        self._answers.extend([(due_ns, data)] * (copies.get(self._kind, 1) if hit else 1))

    def due_answers(self, now_ns: int) -> list[bytes]:
        """Return the answers that are to be sent by now, in their order."""
        due = []
        while self._answers and self._answers[0][0] <= now_ns:
            due.append(self._answers.popleft()[1])
        return due


class FaultyMotor(EmulatedMotor):
    """A motor with an injector of faults, which also spoils the answers of the drive around it."""

    def __init__(self, scene: StepperScene, law: ContactLaw, touch_m: float, now_ns: int) -> None:
        self.injector = FaultInjector(scene.step_m)
        self._late_n: deque[float] = deque()
        super().__init__(scene, law, touch_m, now_ns)

    @property
    def position_steps(self) -> int:
        return self.injector.position_steps(super().position_steps, self._now_ns)

    @property
    def counter_hz(self) -> float:
        injector = self.injector
        return self.rate_hz if injector.counts_shaft else self.rate_hz / injector.motion_ratio

    def run(self, rate_hz: float) -> None:
        super().run(self.injector.executed_hz(rate_hz))

    def _turn(self, target_hz: float) -> float:
        ratio, before = self.injector.motion_ratio, self._counted
        turned = super()._turn(ratio * target_hz)
        if not self.injector.counts_shaft:
            self._counted = before + turned / ratio
        return turned

    def _tick(self) -> None:
        super()._tick()
        self._late_n.append(self.injector.film_n(self.forces_n.pop()))
        while len(self._late_n) > self.injector.film_delay_ns // TICK_NS:
            self.forces_n.append(self._late_n.popleft())


class FaultyTmclModule(EmulatedTmclModule):
    """A TMCL module whose answers the injector of its motor spoils."""

    _motor: FaultyMotor

    def receive(self, request: bytes, now_ns: int) -> None:
        super().receive(request, now_ns)
        for due_ns, answer in self._answers:
            self._motor.injector.queue_answer(answer, due_ns)
        self._answers.clear()

    def due_answers(self, now_ns: int) -> list[bytes]:
        return self._motor.injector.due_answers(now_ns)


class FaultyBoard(EmulatedBoard):
    """A display board with an injector of faults between it and its motor, film and host.

    Its tip is where the count is. versions: fields of its greeting that are changed.
    """

    def __init__(
        self,
        drive: StepdirScene,
        stepper: StepperScene,
        law: ContactLaw,
        film: DriveFilmScene | None,
        now_ns: int,
        noise_n: float = 0.0,
    ) -> None:
        super().__init__(drive, stepper, law, film, now_ns, noise_n, rigid=True)
        self.injector = FaultInjector(stepper.step_m)
        self.versions: dict[str, int] = {}
        self._amplifier = amplifier(film, 0.0)
        self._late_n: deque[float] = deque()
        # Where the board began to count the shaft's steps.
        self._counted_from: int | None = None

    def due_frames(self) -> list[bytes]:
        for frame in super().due_frames():
            self.injector.queue_answer(self._as_read(frame), self._now_ns)
        return self.injector.due_answers(self._now_ns)

    def _pass_ms(self) -> None:
        injector = self.injector
        ratio = injector.motion_ratio
        out = ratio if injector.executed_hz(-1.0) else 0.0
        self._late_n.append(injector.film_n(self.force_n))
        read_n = self._late_n[0]
        while len(self._late_n) > injector.film_delay_ns // TICK_NS:
            read_n = self._late_n.popleft()
        if (ratio, out) != (1.0, 1.0):
            self.sketch.set(turns_in=ratio, turns_out=out)
        if injector.spoils_film:
            film_v = self._amplifier["film_zero_v"] + self._amplifier["film_v_per_n"] * read_n
            self.sketch.set(film_v=film_v, film_noise_v=0.0)
        super()._pass_ms()

    def _as_read(self, frame: bytes) -> bytes:
        """Return a frame as the host reads it, with a false position or version."""
        (body,) = board_reader().feed(b"\0" + frame) or (b"\0",)
        match decode_report(body):
            case BoardState() as state:
                ratio, position, velocity = 1.0, state.position, state.velocity
                if self.injector.counts_shaft:
                    ratio = self.injector.motion_ratio
                    self._counted_from = self._counted_from or position
                    position = round(self._counted_from + ratio * (position - self._counted_from))
                position = self.injector.position_steps(position, self._now_ns)
                velocity = round(ratio * velocity)
                return encode_report(state._replace(position=position, velocity=velocity))
            case BoardGreeting() as greeting if self.versions:
                return encode_report(greeting._replace(**self.versions))
        return frame


class _FaultyNetwork(canopen.Network):
    """A network whose frames pass a fault injector on their way to the bus."""

    def __init__(self, bus: can.BusABC, injector: FaultInjector) -> None:
        super().__init__(bus)
        self._injector = injector

    def send_message(self, can_id: int, data: bytes, remote: bool = False) -> None:
        frame = _IDENTIFIER.pack(can_id) + bytes(data)
        self._injector.queue_answer(frame, time.perf_counter_ns(), header=_IDENTIFIER.size)
        self.send_due()

    def send_due(self) -> None:
        for frame in self._injector.due_answers(time.perf_counter_ns()):
            (can_id,) = _IDENTIFIER.unpack_from(frame)
            super().send_message(can_id, frame[_IDENTIFIER.size :])


class FaultyCia402Node(EmulatedCia402Node):
    """A CiA 402 node whose frames the injector of its motor spoils."""

    motor: FaultyMotor
    _network: _FaultyNetwork

    def network(self, bus: can.BusABC) -> canopen.Network:
        return _FaultyNetwork(bus, self.motor.injector)

    def poll(self) -> None:
        super().poll()
        self._network.send_due()
