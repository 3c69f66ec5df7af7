"""An emulated display board: its own sketch at an emulated motor, on a pseudo-terminal.

The board itself is pure: time is an argument, and it returns the frames that the sketch sends. Its
motor, screw, rubber, finger and film are those of `firmware/mechanics.h`, which has what they leave
out.
"""

import select
import time
from collections import deque
from collections.abc import Callable
from typing import Any

from display_node.plant.contact import ContactLaw
from display_node.plant.scene import StepperScene
from pulse_drives.stepdir.frames import BoardLimits, BoardMode
from pulse_drives.stepdir.scene import StepdirScene
from pulse_sensors.drive_film import DriveFilmScene
from sensing_node.press.probe import CLEARANCE_M
from telepulse.emulators import PtyPort
from telepulse.emulators.motor import TICK_NS, TICK_S, MotorFault, MotorState
from telepulse.emulators.sketch import Sketch
from telepulse.emulators.wrist import TissueContact

RESET_PIN = 2
FAULT_PIN = {"none": 0, "low": 1, "high": 2}
# Of the emulated motor: it gives its scene's acceleration with this share of its thrust.
STEPS_PER_TURN, THRUST_N, THRUST_SHARE = 200 * 16, 1200.0, 0.25
# Of a reading, the sum of 16 conversions of 10 bits, each of which rounds down.
CONVERSIONS = 16
COUNTS_PER_V = CONVERSIONS * 1024 / 5
ROUNDED_COUNTS = CONVERSIONS / 2
FAULTLESS = {"carrier_off": 0.0, "fault": 0.0, "turns_in": 1.0, "turns_out": 1.0}
FAULTS: dict[MotorFault, dict[str, float]] = {
    "overtemperature": {"carrier_off": 1, "fault": 1},
    "stall": {"turns_in": 0, "turns_out": 0, "fault": 1},
    "following error": {"turns_in": 0, "turns_out": 0},
}


class EmulatedBoard:
    """A board with its motor under a finger, from power-up on.

    Parameters
    ----------
    drive, stepper, law
        The scene's board and its wiring, its motor, and the contact of tip and finger.
    film
        The scene's table, which gives the counts of a force; None where none is connected.
    noise_n
        RMS of a reading of the film in N.
    rigid
        The tip is where the count is, at once.

    Attributes
    ----------
    sketch
        The running sketch, whose `set` begins faults of film, switch and motor.
    view
        The board after the last millisecond: `host_view` of firmware/host/host.h.
    forces_n
        Forces under the tip, one per millisecond, until a reader takes them.
    trace
        Called with the motor's state every millisecond.
    trouble
        "silent" where it sends nothing, "garbled" where it sends wrong bytes, else "".

    Raises ProcessError where the sketch cannot be compiled.
    """

    def __init__(
        self,
        drive: StepdirScene,
        stepper: StepperScene,
        law: ContactLaw,
        film: DriveFilmScene | None,
        now_ns: int,
        noise_n: float = 0.0,
        rigid: bool = False,
    ) -> None:
        settings = _wiring(drive) | _mechanics(drive, stepper, law) | amplifier(film, noise_n)
        self.sketch = Sketch(rigid=rigid, **settings)
        self.sketch.power_up()
        self.view: Any = self.sketch.look()
        self._now_ns = now_ns
        self._sent = bytearray()
        self.forces_n: deque[float] = deque(maxlen=10_000)
        self.trace: Callable[[MotorState], None] | None = None
        self.trouble = ""

    @property
    def mode(self) -> BoardMode:
        """State of the sketch's state machine."""
        return BoardMode(self.view.state)

    @property
    def limits(self) -> BoardLimits | None:
        """The limits that it was given; None before any."""
        if not self.view.has_limits:
            return None
        return BoardLimits(*(getattr(self.view, f"limits_{name}") for name in BoardLimits._fields))

    @property
    def homing(self) -> bool:
        """True while a search for the home switch is under way."""
        return self.mode is BoardMode.HOMING

    @property
    def rate_hz(self) -> float:
        """Step rate, positive towards the finger."""
        rate_hz: float = self.view.velocity
        return rate_hz

    @property
    def tip_m(self) -> float:
        """Position of the tip from first touch."""
        tip_m: float = self.view.tip_m
        return tip_m

    @property
    def force_n(self) -> float:
        """Force under the tip."""
        force_n: float = self.view.force_n
        return force_n

    def fail(self, fault: MotorFault) -> None:
        """Begin a fault of the motor, until `reset`; the board goes on counting its steps."""
        self.sketch.set(**FAULTS[fault])

    def reset(self) -> None:
        """Clear the motor's fault."""
        self.sketch.set(**FAULTLESS)

    def restart(self) -> None:
        """Restart the sketch, as by the reset pin."""
        self.sketch.reset(RESET_PIN)

    def receive(self, data: bytes, now_ns: int) -> None:
        """Take bytes from the host at a time."""
        self.advance(now_ns)
        self.sketch.feed(data)

    def advance(self, now_ns: int) -> None:
        """Advance to the present, a millisecond at a time."""
        while self._now_ns + TICK_NS <= now_ns:
            self._now_ns += TICK_NS
            self._pass_ms()

    def due_frames(self) -> list[bytes]:
        """Return the frames that it has sent since the last call."""
        *bodies, self._sent = self._sent.split(b"\0")
        frames = [bytes(body) + b"\0" for body in bodies]
        match self.trouble:
            case "silent":
                return []
            case "garbled":
                return [bytes([frame[0] ^ 0x55, *frame[1:]]) for frame in frames]
        return frames

    def _pass_ms(self) -> None:
        before_m = self.tip_m
        self.sketch.run(1)
        self._sent += self.sketch.take()
        self.view = self.sketch.look()
        self.forces_n.append(self.force_n)
        if self.trace is not None:
            speed_m_per_s = (self.tip_m - before_m) / TICK_S
            self.trace(MotorState(self._now_ns, self.tip_m, speed_m_per_s, self.force_n))


def _wiring(drive: StepdirScene) -> dict[str, float]:
    return {
        "inverted": drive.inverted,
        "normally_closed": drive.home_switch == "normally_closed",
        "fault_pin": FAULT_PIN[drive.fault_pin],
    }


def _mechanics(drive: StepdirScene, stepper: StepperScene, law: ContactLaw) -> dict[str, float]:
    """Return the settings of motor, screw and what the tip presses; it begins half way to touch."""
    settings = {
        "lead_mm": stepper.step_m * STEPS_PER_TURN * 1e3,
        "touch_mm": drive.touch_m * 1e3,
        "start_mm": drive.touch_m * -0.5e3,
        "thrust_n": THRUST_N,
        "mass_kg": THRUST_SHARE * THRUST_N / stepper.max_acceleration_m_per_s2,
    }
    if isinstance(law, TissueContact):
        tissue = law.tissue
        return settings | {
            "knee_n": tissue.knee_n,
            "length_mm": tissue.length_m * 1e3,
            "clearance_mm": CLEARANCE_M * 1e3,
        }
    return settings | {
        "hertz": (law.position(1.0) - law.finger_m_per_n) ** -1.5,
        "finger_n_per_m": 1 / law.finger_m_per_n,
    }


def amplifier(film: DriveFilmScene | None, noise_n: float) -> dict[str, float]:
    """Return the settings of a film's amplifier; without a film it rests in the middle."""
    if film is None:
        return {"film_zero_v": 2.5, "film_v_per_n": 0.0, "film_noise_v": 0.0}
    per_count_n = film.newtons_per_count or 1.0
    zero = film.zero - film.preload_n / per_count_n
    v_per_n = 1 / per_count_n / COUNTS_PER_V
    return {
        "film_zero_v": (zero + ROUNDED_COUNTS) / COUNTS_PER_V,
        "film_v_per_n": v_per_n,
        # A reading is the sum of conversions.
        "film_noise_v": noise_n * v_per_n * CONVERSIONS**0.5,
    }


def serve_board(board: EmulatedBoard, port: PtyPort) -> Callable[[float], None]:
    """Return a function that takes what comes within a time in s, and sends what is due."""

    def serve(wait_s: float) -> None:
        readable, _, _ = select.select([port], [], [], wait_s)
        data = port.read() if readable else b""
        board.receive(data, time.perf_counter_ns())
        for frame in board.due_frames():
            port.write(frame)

    return serve
