"""The motor of an emulated drive: the physical stepper, its home switch, watchdog and faults. Pure.

Time is an argument. The motor advances in whole milliseconds; a command in between takes effect at
its own time. Not modelled: electrical dynamics, torque over speed, temperature, single lost steps.
"""

import math
from collections import deque
from collections.abc import Callable
from typing import Literal, NamedTuple

from display_node.plant.contact import ContactLaw
from display_node.plant.scene import StepperScene
from display_node.plant.stepper import Stepper

TICK_NS = 1_000_000
TICK_S = TICK_NS * 1e-9
# The home switch closes this far before the end of the stroke, on the side away from the finger.
SWITCH_M = 0.2e-3

MotorFault = Literal["overtemperature", "following error", "stall"]


class MotorState(NamedTuple):
    """The motor's state at a time; position and speed are positive into the finger.

    tip_m: position of the tip from first touch. force_n: force under the tip.
    """

    time_ns: int
    tip_m: float
    speed_m_per_s: float
    force_n: float


class EmulatedMotor:
    """A stepper over a finger that begins `touch_m` below its home switch.

    At the start the tip is half way between them, and the drive's counter is 0 at that place until
    the drive has homed.

    rate_hz: step rate of the shaft, positive towards the finger. tip_m: position of the tip from
    first touch. tripped: the watchdog has stopped the motor. forces_n: forces for the film to send,
    one per millisecond, until a reader takes them. trace: called with the state every millisecond.
    """

    def __init__(self, scene: StepperScene, law: ContactLaw, touch_m: float, now_ns: int) -> None:
        # The emulated drive limits its own travel, so the stepper has the whole stroke. Commands
        # take their own time to arrive, so the scene's latency is not added.
        free = scene.model_copy(update={"thrust_n": math.inf, "latency_ns": 0})
        # A drive sends step rates, in place of speeds.
        self._stepper = Stepper(free, law, math.inf, TICK_S, steps_per_m=1.0)
        self._law = law
        self._thrust_n, self._step_m = scene.thrust_n, scene.step_m
        self._touch_m = SWITCH_M + touch_m
        self._target_hz = 0.0
        self._homing: Literal["seek", "leave", "rest"] | None = None
        self._search_hz = self._leave_hz = 0.0
        self._watchdog_ns = 0
        self._fed_ns = self._now_ns = self._command_ns = now_ns
        # Correction, in steps times ns, for a command that arrived within the present tick.
        self._carry = 0.0
        self._zero_steps = 0
        self._least_steps, self._most_steps = -math.inf, math.inf
        self.rate_hz = self.force_n = 0.0
        self.fault: MotorFault | None = None
        self.tripped = False
        self.forces_n: deque[float] = deque(maxlen=10_000)
        self.trace: Callable[[MotorState], None] | None = None
        while self._stepper.screw_m < SWITCH_M + touch_m / 2:
            self._stepper.move(2e-3 / self._step_m)
        self._stepper.move(0.0)
        self._counted = self._stepper.screw_m / self._step_m
        self.tip_m = self._stepper.tip_m - self._touch_m
        self.zero()

    @property
    def position_steps(self) -> int:
        """The drive's counter as the bus reports it, positive towards the finger."""
        return self._counter

    @property
    def counter_hz(self) -> float:
        """The signed step rate as the drive counts it: one without an encoder counts its steps."""
        return self.rate_hz

    @property
    def homing(self) -> bool:
        """True while a search for the home switch is under way."""
        return self._homing is not None

    @property
    def at_switch(self) -> bool:
        """True while the home switch is closed."""
        return round(self._stepper.screw_m / self._step_m) * self._step_m <= SWITCH_M

    def run(self, rate_hz: float) -> None:
        """Go to this signed step rate, as fast as the acceleration allows."""
        self._homing = None
        before_hz = self._target_hz
        self._target_hz = 0.0 if self.fault else rate_hz
        self._carry += (before_hz - self._target_hz) * max(0, self._command_ns - self._now_ns)

    def home(self, search_hz: float, leave_hz: float) -> None:
        """Search the home switch; the counter is set to 0 where the switch opens again."""
        if not self.fault:
            self._homing = "seek"
            self._search_hz, self._leave_hz = search_hz, leave_hz

    def zero(self) -> None:
        """Set the counter to 0 here."""
        self._zero_steps = round(self._counted)

    def limit(self, least_steps: float, most_steps: float) -> None:
        """Set the drive's own soft limits, in steps of its counter; infinite for none."""
        self._least_steps, self._most_steps = least_steps, most_steps

    def fail(self, fault: MotorFault) -> None:
        """Come to rest with a fault, until `reset`."""
        self.run(0.0)
        self.fault = fault

    def reset(self) -> None:
        """Clear the fault."""
        self.fault, self.tripped = None, False

    def set_watchdog(self, period_ns: int) -> None:
        """Come to rest when the watchdog is not fed for this long; 0: never."""
        self._watchdog_ns = period_ns
        self.feed()

    def feed(self) -> None:
        """Feed the watchdog."""
        self._fed_ns, self.tripped = self._now_ns, False

    def advance(self, now_ns: int) -> None:
        """Advance to the present."""
        while self._now_ns + TICK_NS <= now_ns:
            self._now_ns += TICK_NS
            self._tick()
        self._command_ns = max(now_ns, self._now_ns)

    @property
    def _counter(self) -> int:
        return round(self._counted) - self._zero_steps

    def _tick(self) -> None:
        silent_ns = self._now_ns - self._fed_ns
        if self._watchdog_ns and silent_ns > self._watchdog_ns and not self.tripped:
            self.run(0.0)
            self.tripped = True
        target_hz = self._seek() if self._homing else self._target_hz + self._carry / TICK_NS
        self._carry = 0.0
        if self._at_limit(target_hz):
            target_hz = 0.0
        rate_hz = self._turn(target_hz) / TICK_S
        self.rate_hz = rate_hz
        self.tip_m = self._stepper.tip_m - self._touch_m
        self.force_n = self._law.force(self.tip_m)
        self.forces_n.append(self.force_n)
        if self.trace is not None:
            speed_m_per_s = rate_hz * self._step_m
            self.trace(MotorState(self._now_ns, self.tip_m, speed_m_per_s, self.force_n))
        if self.force_n > self._thrust_n and not self.fault:
            self.fail("stall")

    def _turn(self, target_hz: float) -> float:
        """Turn the shaft for a millisecond; return the steps that it turned."""
        before_m = self._stepper.screw_m
        self._stepper.move(target_hz)
        turned = (self._stepper.screw_m - before_m) / self._step_m
        self._counted += turned
        return turned

    def _at_limit(self, target_hz: float) -> bool:
        """Return whether the switch or, except while homing, a soft limit stops this motion."""
        limited = not self._homing
        if target_hz < 0:
            return (limited and self._counter <= self._least_steps) or self.at_switch
        return target_hz > 0 and limited and self._counter >= self._most_steps

    def _seek(self) -> float:
        """Return the search's step rate: to the switch, off it again, and to rest."""
        if self._homing == "seek":
            if not self.at_switch:
                return -self._search_hz
            self._homing = "leave"
        if self._homing == "leave":
            if self.at_switch:
                return self._leave_hz
            self.zero()
            self._homing = "rest"
        if self.rate_hz == 0.0:
            self.run(0.0)
        return 0.0
