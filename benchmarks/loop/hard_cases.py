"""Hard cases of the force loop: what a display's contactor comes to in each.

A contactor is driven as a display drives it, tick by tick, but without a stream: by beats for some
seconds, then by a constant force.
"""

import math
from collections.abc import Callable, Mapping
from typing import Any, Final, NamedTuple

import numpy as np

from display_node.contactor import Contactor
from display_node.control.linear_loop import UnstableLoopError
from display_node.control.link_loss import Fade
from protocol.tactile import JND
from telepulse.scene import load_scene

# A beat is half of a sine, squared. The last second is judged.
HEIGHT_N, HELD_N, BEAT_S, PULSE_S = 0.3, 0.3, 0.8, 0.3
BEATS_S, SECONDS, JUDGED_S = 3.0, 5.0, 1.0
# A force that stays within what a finger notices has settled.
SETTLED_N: Final = JND * HEIGHT_N
JUMP_N, JUMP_EVERY_S, BREAKS_AT_S, LATE_TICKS = 1e30, 0.1, 1.0, 3
SETTLES, BOUNDED, UNBOUNDED, REFUSED = "settles", "bounded", "unbounded", "refused at load"


def beats(time_s: float) -> float:
    """Return the force of a pulse in N."""
    into_s = time_s % BEAT_S
    swing = math.sin(math.pi * into_s / PULSE_S) if into_s < PULSE_S else 0.0
    return HELD_N + HEIGHT_N * swing * swing


class HardCase(NamedTuple):
    """A case: changes of a scene, and what then acts on its loop.

    Attributes
    ----------
    display
        Changes of the scene's [display], which the loop is designed for.
    actual
        Attributes in which the simulated stepper differs from the scene's.
    wanted
        Force in N at a time in s, in place of beats.
    read
        Film's reading in N, from the number of the tick and what it would read.
    late
        Number of ticks by which a tick is late, from its number.
    """

    display: Mapping[str, Any] = {}
    actual: Mapping[str, Any] = {}
    wanted: Callable[[float], float] = beats
    read: Callable[[int, float], float] = lambda _, reading_n: reading_n
    late: Callable[[int], int] = lambda _: 0


def cases(name: str) -> dict[str, HardCase]:
    """Return the hard cases of a shipped scene."""
    display = load_scene(name).display
    breaks_at = round(BREAKS_AT_S * 1e9 / display.tick_ns)
    of_any = {
        "as it is": HardCase(),
        "slew of at most 1 N/s": HardCase({"safety": {"slew_limit": "1 N/s"}}),
        "jumps between ±1e30 N": HardCase(
            wanted=lambda time_s: JUMP_N * (-1) ** int(time_s / JUMP_EVERY_S)
        ),
        "gains ten times too high": HardCase(
            {
                "controller": {
                    key: 10 * getattr(display.controller, key) for key in ("kp", "ki", "kd")
                }
            }
        ),
        "film with a lag of 30 ms": HardCase({"film": {"latency": "30 ms"}}),
        "film that reads NaN for one tick": HardCase(
            read=lambda tick, reading_n: math.nan if tick == breaks_at else reading_n
        ),
        "film that reads NaN for good": HardCase(
            read=lambda tick, reading_n: math.nan if tick >= breaks_at else reading_n
        ),
        "one tick comes three ticks late": HardCase(
            late=lambda tick: LATE_TICKS if tick == breaks_at else 0
        ),
        "every tick comes three ticks late": HardCase(late=lambda _: LATE_TICKS),
    }
    if display.actuator.stepper is None:
        return of_any | {"output of at most 10 V": HardCase({"actuator": {"voltage_limit": 10}})}
    return of_any | {
        "speed of at most 1 mm/s": HardCase({"actuator": {"max_speed": "1 mm/s"}}),
        "finger of 0.01 N/mm": HardCase({"actuator": {"fingertip": "0.01 N/mm"}}),
        "finger of 1000 N/mm": HardCase({"actuator": {"fingertip": "1000 N/mm"}}),
        "finger of 0.01 N/mm, scene 1 N/mm": HardCase(actual={"fingertip_n_per_m": 10.0}),
        "finger of 5 N/mm, scene 1 N/mm": HardCase(actual={"fingertip_n_per_m": 5e3}),
        "finger of 1000 N/mm, scene 1 N/mm": HardCase(actual={"fingertip_n_per_m": 1e6}),
        "layer of 1 Pa": HardCase({"layer": {"young_modulus": "1 Pa"}}),
        "backlash of 0.2 mm": HardCase({"actuator": {"backlash": "0.2 mm"}}),
        "backlash of 0.2 mm, not in the scene": HardCase(actual={"backlash_m": 0.2e-3}),
        "rotor that rings: 100 Hz, ζ = 0.02": HardCase(
            {"actuator": {"rotor_resonance": "100 Hz", "rotor_damping": 0.02}}
        ),
        "rotor that rings, not in the scene": HardCase(
            actual={"rotor_resonance_hz": 100.0, "rotor_damping": 0.02}
        ),
    }


class Outcome(NamedTuple):
    """A verdict with what decides it.

    most_n: greatest force, of either sign. off_n: greatest difference from the last target while
    judged. reason: the display's, not to load the scene, or to end the pulse.
    """

    verdict: str
    most_n: float = math.nan
    off_n: float = math.nan
    reason: str = ""

    def __str__(self) -> str:
        if self.verdict is REFUSED:
            return f"{self.verdict}: {self.reason}"
        figures = f"at most {self.most_n:.3g} N, {1e3 * self.off_n:.1f} mN off"
        return f"{self.verdict}: {figures}" + (f" 0 N; {self.reason}" if self.reason else "")


def play(name: str, case: HardCase) -> Outcome:
    """Play a case on a shipped scene's contactor."""
    scene = load_scene(name, display=case.display).display
    try:
        contactor = Contactor(scene, score=False)
    except UnstableLoopError as error:
        return Outcome(REFUSED, reason=error.reason)
    if case.actual:
        contactor.loop = scene.force_loop(scene.actuator.model_copy(update=case.actual))
    loop, tick_s, fade = contactor.loop, scene.tick_ns * 1e-9, Fade(scene.safety, scene.tick_ns)
    read_film = loop.read_film
    loop.read_film = lambda: case.read(tick, read_film())  # type: ignore[method-assign]
    tick, most_n, judged_n = 0, 0.0, []
    while (now_s := tick * tick_s) < SECONDS:
        if late := case.late(tick):
            loop.coast(late)
            fade.skip(1 + late)
        tick += late
        # As `Display.command`, without a stream.
        begin_s = tick * tick_s + loop.actuation_delay_ns * 1e-9
        times_s = (begin_s + ahead * tick_s for ahead in range(contactor.reference_ticks))
        wanted_n = [case.wanted(at_s) if at_s < BEATS_S else HELD_N for at_s in times_s]
        now_ns = tick * scene.tick_ns
        contactor.play(wanted_n, now_ns, now_ns, alive=True, full=fade.gain == 1.0)
        contactor.read_force(now_ns, fade)
        contactor.command(fade.advance(alive=True), fade)
        loop.move()
        contactor.account(alive=True)
        most_n = max(most_n, abs(loop.felt_n)) if math.isfinite(loop.felt_n) else math.inf
        if now_s >= SECONDS - JUDGED_S:
            judged_n.append(loop.felt_n)
        tick += 1
    off_n = float(np.abs(np.array(judged_n) - (0.0 if fade.faults else HELD_N)).max())
    settled = SETTLES if off_n <= SETTLED_N else BOUNDED
    verdict = settled if most_n <= scene.safety.overforce_n else UNBOUNDED
    return Outcome(verdict, most_n, off_n, "; ".join(map(str, fade.faults)))
