"""The motor inside an emulated drive: the physical stepper, its switch, its watchdog, its faults.

Pure: time is an argument. It advances in whole milliseconds; what it is told on the way counts
from when it was told.
"""

import math
from collections import deque
from collections.abc import Callable
from typing import Literal, NamedTuple

from display_node.plant.contact import ContactLaw
from display_node.plant.stepper import Stepper, StepperScene
from telepulse.emulators.fault_injection import FaultInjector

TICK_NS = 1_000_000
TICK_S = TICK_NS * 1e-9
# The home switch closes this far before the end of the stroke, on the side away from the finger.
SWITCH_M = 0.2e-3

MotorFault = Literal["overtemperature", "following error", "stall"]


class MotorState(NamedTuple):
    """The motor's state at a time: the tip's place from first touch and its speed, both positive
    into the finger, and the force under it."""

    time_ns: int
    tip_m: float
    speed_m_per_s: float
    force_n: float


class EmulatedMotor:
    """A stepper over a finger that begins `touch_m` below its home switch.

    When it is switched on, the tip stands half way between the two, and there the drive's own
    counter is 0 until it has homed.

    position_steps: of the counter as the bus reports it, rate_hz: of the shaft, both signed,
    positive towards the finger. tip_m: from first touch. rested_ns: when it came to rest last.
    forces_n: of the film, one a millisecond, as far as nobody took them. trace: is given every
    millisecond. lies: what is false about it.
    """

    def __init__(self, scene: StepperScene, law: ContactLaw, touch_m: float, now_ns: int) -> None:
        # The stepper's own soft stop is the drive's business here: it has the whole stroke. And
        # commands take their own time on the way: the scene's latency is not added to it.
        free = scene.model_copy(update={"thrust_n": math.inf, "latency_ns": 0})
        self._stepper = Stepper(free, law, math.inf, TICK_S)
        self._law = law
        self._thrust_n = scene.thrust_n
        self._touch_m = SWITCH_M + touch_m
        self._step_m = scene.step_m
        self._target_hz = 0.0
        self._homing: Literal["seek", "leave", "rest"] | None = None
        self._search_hz = self._leave_hz = 0.0
        self._watch_ns = 0
        self._fed_ns = self._now_ns = self._told_ns = self.rested_ns = now_ns
        # Steps times ns by which the next tick goes further than its last command says.
        self._owed = 0.0
        self._counted = 0.0
        self._zero_steps = 0
        self._least_steps, self._most_steps = -math.inf, math.inf
        self.rate_hz = 0.0
        self.tip_m = -self._touch_m
        self.force_n = 0.0
        self.fault: MotorFault | None = None
        self.tripped = False
        self.forces_n: deque[float] = deque(maxlen=10_000)
        self.trace: Callable[[MotorState], None] | None = None
        self.lies = FaultInjector(scene.step_m)
        self._place(SWITCH_M + touch_m / 2)

    @property
    def position_steps(self) -> int:
        """The drive's counter, as the bus reports it."""
        return self.lies.position_steps(self._counter, self._now_ns)

    @property
    def counter_hz(self) -> float:
        """The step rate as the drive counts it, signed."""
        return self.rate_hz if self.lies.by_encoder else self.rate_hz / self.lies.motion

    @property
    def homing(self) -> bool:
        """True while a search for the home switch is under way."""
        return self._homing is not None

    @property
    def at_switch(self) -> bool:
        """True while the home switch is closed."""
        return self._steps * self._step_m <= SWITCH_M

    def run(self, rate_hz: float) -> None:
        """Go to this signed step rate, as fast as the acceleration allows."""
        self._homing = None
        obeyed_hz = 0.0 if self.fault else self.lies.obeyed_hz(rate_hz)
        before_hz, self._target_hz = self._target_hz, obeyed_hz
        self._owed += (before_hz - self._target_hz) * max(0, self._told_ns - self._now_ns)

    def home(self, search_hz: float, leave_hz: float) -> None:
        """Look for the home switch; the counter's zero is where it opens again."""
        if not self.fault:
            self._homing = "seek"
            self._search_hz, self._leave_hz = search_hz, leave_hz

    def zero(self) -> None:
        """The counter is 0 here."""
        self._zero_steps = round(self._counted)

    def limit(self, least_steps: float, most_steps: float) -> None:
        """The drive's own soft limits, in steps of its counter; infinite for none."""
        self._least_steps, self._most_steps = least_steps, most_steps

    def fail(self, fault: MotorFault) -> None:
        """Something breaks: the motor comes to rest, and stays there until `reset`."""
        self.run(0.0)
        self.fault = fault

    def reset(self) -> None:
        """Forget the fault."""
        self.fault = None
        self.tripped = False

    def watch(self, period_ns: int) -> None:
        """Come to rest where nobody has fed the watchdog for this long; 0: never."""
        self._watch_ns = period_ns
        self._fed_ns = self._now_ns
        self.tripped = False

    def feed(self) -> None:
        """Somebody is there."""
        self._fed_ns = self._now_ns
        self.tripped = False

    def advance(self, now_ns: int) -> None:
        """Come to the present."""
        while self._now_ns + TICK_NS <= now_ns:
            self._now_ns += TICK_NS
            self._tick()
        self._told_ns = max(now_ns, self._now_ns)

    @property
    def _steps(self) -> int:
        return round(self._stepper.screw_m / self._step_m)

    @property
    def _counter(self) -> int:
        return round(self._counted) - self._zero_steps

    @property
    def _ends_away(self) -> bool:
        limited = not self._homing and self._counter <= self._least_steps
        return limited or self.at_switch

    @property
    def _ends_below(self) -> bool:
        return not self._homing and self._counter >= self._most_steps

    def _tick(self) -> None:
        if self._watch_ns and self._now_ns - self._fed_ns > self._watch_ns and not self.tripped:
            self.run(0.0)
            self.tripped = True
        target_hz = self._seek() if self._homing else self._target_hz + self._owed / TICK_NS
        self._owed = 0.0
        if (target_hz < 0 and self._ends_away) or (target_hz > 0 and self._ends_below):
            target_hz = 0.0
        before_m = self._stepper.screw_m
        lies = self.lies
        travel_m = self._stepper.move(lies.motion * target_hz)
        turned = (self._stepper.screw_m - before_m) / self._step_m
        self._counted += turned if lies.by_encoder else turned / lies.motion
        rate_hz = turned / TICK_S
        if self.rate_hz and not rate_hz:
            self.rested_ns = self._now_ns
        self.rate_hz = rate_hz
        self.tip_m = travel_m - self._touch_m
        self.force_n = self._law.force(self.tip_m)
        self.forces_n.append(lies.film_n(self.force_n))
        if self.trace is not None:
            speed_m_per_s = rate_hz * self._step_m
            self.trace(MotorState(self._now_ns, self.tip_m, speed_m_per_s, self.force_n))
        if self.force_n > self._thrust_n and not self.fault:
            self.fail("stall")

    def _seek(self) -> float:
        """The search's step rate: to the switch, off it again, and to rest."""
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

    def _place(self, travel_m: float) -> None:
        """Place the tip where it stands at the beginning."""
        while self._stepper.screw_m < travel_m:
            self._stepper.move(2e-3 / self._step_m)
        self._stepper.move(0.0)
        self._counted = self._stepper.screw_m / self._step_m
        self.tip_m = self._stepper.tip_m - self._touch_m
        self.zero()
