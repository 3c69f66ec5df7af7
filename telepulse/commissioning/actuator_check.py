"""Press and identification of an actuator: measured values, compared with those in the scene."""

import copy
import math
from dataclasses import dataclass, replace

import numpy as np

from display_node.plant.scene import SecondOrderScene, StepperScene
from display_node.scene import DisplayScene
from telepulse.commissioning.identification import (
    MAX_HALF_WIDTH,
    ActuatorInput,
    IdentifiedModel,
    identify,
)
from telepulse.commissioning.press import (
    GUARD,
    ContactFit,
    PressPhase,
    PressRecorder,
    fit_contact,
    press_stepper,
    press_voltage,
    through_film,
)
from telepulse.commissioning.rig import Rig
from telepulse.commissioning.sensor_check import Check, grade, with_warning

MAX_LATENCY_S = 0.05
# The fit of the backlash needs the latency, and the fit of the latency needs the backlash.
ROUNDS = 2
# Unexplained RMS as a share of the whole force change (eq 22 of the paper).
UNEXPLAINED_WARN, UNEXPLAINED_FAIL = 0.1, 0.3
FINGER_WARN = 0.2
TRAVEL_WARN, TRAVEL_FAIL = 0.05, 0.5
# A sensor's stamps may be early by part of a tick: the time of its first byte is unknown.
EARLY_TICKS = 0.25
# A fitted latency below this is the fit's lower bound, 0.
TINY_LATENCY_S = 1e-6
# Backlash holds the tip at the rotor's overshoot, which makes the fitted latency less certain.
LATENCY_WARN_TICKS, LATENCY_WARN_BACKLASH_TICKS = 1.0, 2.0


@dataclass(frozen=True, slots=True)
class ActuatorFindings:
    """The results for an actuator.

    Attributes
    ----------
    command : ActuatorInput
        Commands of the staircase, after the film's filter.
    contact : ContactFit or None
        The contact under a stepper.
    keys : dict
        Keys of [display.actuator] that the press determines.
    """

    pressed: PressRecorder
    command: ActuatorInput
    identified: IdentifiedModel
    contact: ContactFit | None
    checks: tuple[Check, ...]
    keys: dict[str, float | str]


def check_actuator(
    rig: Rig, scene: DisplayScene, force_n: float, film_age_s: float, line_latency_s: float = 0.0
) -> ActuatorFindings:
    """Press with at most force_n and identify the actuator.

    Parameters
    ----------
    film_age_s : float
        The film's share of the latency; the rest is the actuator's.
    line_latency_s : float
        Transmission time of a command on the bus or serial line; 0 for a model.

    Raises
    ------
    BenchError
        For a press that was stopped, or a record from which no parameter can be identified.
    """
    pressed = PressRecorder(rig, GUARD * force_n, scene.safety.feedback_within_ns * 1e-9)
    actuator, film = scene.actuator, scene.film
    keys: dict[str, float | str] = {}
    stepper = actuator.stepper
    if stepper is None:
        model = SecondOrderScene.narrow(actuator, "[display] actuator: to design a press,")
        press_voltage(pressed, model, force_n)
        command = through_film(pressed.command(pressed.stairs, held=True), film)
        identified = identify(command, *pressed.film(pressed.stairs), MAX_LATENCY_S)
        if _fits(identified):
            values = zip("mck", identified.values, strict=False)
            keys = {key: float(f"{value:.4g}") for key, value in values}
        return ActuatorFindings(pressed, command, identified, None, (_check_fit(identified),), keys)
    press_stepper(pressed, stepper, force_n)
    # Filtered from the beginning of the press, so that the filter has settled by the staircase. A
    # real rig's ticks are late: the grid is that of the staircase, or its latency would be off.
    stairs, tick_s = pressed.stairs, rig.tick_s
    first = round((stairs.begin_s - pressed.commanded_s[0]) / tick_s)
    travel = pressed.command(PressPhase(stairs.begin_s - first * tick_s, stairs.end_s))
    contact_law, lag_s = stepper.contact(scene.layer.layer()), 0.0
    for _ in range(ROUNDS):
        contact = fit_contact(pressed, contact_law, film, lag_s)
        fitted = copy.copy(contact_law)
        fitted.finger_m_per_n = 1 / contact.finger_n_per_m
        filtered = through_film(contact.pressed_n(fitted, travel), film)
        command = ActuatorInput(filtered.values[first:], filtered.tick_s, held=False)
        identified = identify(command, *pressed.film(pressed.stairs), MAX_LATENCY_S)
        lag_s = identified.delay_s
    latency_s = _latency_s(stepper, identified, contact) - film_age_s
    latency, plausible = check_latency(
        stepper, identified, contact, latency_s, line_latency_s=line_latency_s, tick_s=rig.tick_s
    )
    if _fits(identified):
        keys = _keys(stepper, identified, contact, latency_s if plausible else None)
    checks = (
        _check_fit(identified),
        _check_travel(identified),
        *check_contact(stepper, contact),
        latency,
    )
    return ActuatorFindings(pressed, command, identified, contact, checks, keys)


def _fits(identified: IdentifiedModel) -> bool:
    """Return whether the fit is good enough for a scene."""
    return identified.nrmse <= UNEXPLAINED_FAIL


def _latency_s(actuator: StepperScene, identified: IdentifiedModel, contact: ContactFit) -> float:
    """Return the latency for the scene's model: time from command to motion, plus the film's age.

    A rotor in the scene adds a delay of 2ζ/ω to the latency.
    """
    if _rotor_determined(identified, contact):
        return identified.model.latency_s
    if actuator.rotor_resonance_hz is None:
        return identified.delay_s
    rotor_s = 2 * actuator.rotor_damping / (2 * math.pi * actuator.rotor_resonance_hz)
    return identified.delay_s - rotor_s


def _rotor_determined(identified: IdentifiedModel, contact: ContactFit) -> bool:
    """Return whether the fitted resonance is the rotor's.

    With backlash the rotor's swing back does not reach the film.
    """
    return not {"m", "c"} & set(identified.undetermined) and not contact.has_backlash


def _keys(
    actuator: StepperScene,
    identified: IdentifiedModel,
    contact: ContactFit,
    latency_s: float | None,
) -> dict[str, float | str]:
    keys: dict[str, float | str] = {"fingertip": f"{contact.finger_n_per_m:.4g} N/m"}
    if contact.has_backlash and contact.backlash_m > actuator.step_m:
        keys["backlash"] = f"{contact.backlash_m * 1e6:.3g} µm"
    if _rotor_determined(identified, contact):
        keys["rotor_resonance"] = f"{identified.model.resonance_hz:.4g} Hz"
        keys["rotor_damping"] = float(f"{identified.model.damping:.3g}")
    if latency_s is not None:
        keys["latency"] = f"{max(0.0, latency_s) * 1e3:.3g} ms"
    return keys


def _check_fit(identified: IdentifiedModel) -> Check:
    check = grade(
        "eq 22",
        f"leaves {identified.nrmse * 100:.1f} % of the force's change unexplained",
        identified.nrmse,
        UNEXPLAINED_WARN,
        UNEXPLAINED_FAIL,
        "the actuator is not of second order, or loses steps: see the plot",
    )
    if check.verdict == "ok" and identified.undetermined:
        names = ", ".join(identified.undetermined)
        return Check(check.name, f"{check.text}; {names}: not determined by the record")
    return check


def _check_travel(identified: IdentifiedModel) -> Check:
    check = grade(
        "travel",
        f"a step moves by {100 / identified.model.k:.1f} % of the commanded travel",
        abs(1 / identified.model.k - 1),
        TRAVEL_WARN,
        TRAVEL_FAIL,
        "commands or steps are lost, or lead and microsteps are wrong",
    )
    undetermined = "the record does not determine it" if "k" in identified.undetermined else ""
    return with_warning(check, _fit_warning(identified) or undetermined)


def _fit_warning(identified: IdentifiedModel) -> str:
    if _fits(identified):
        return ""
    return f"not valid: eq 22 leaves {identified.nrmse * 100:.0f} % unexplained"


def check_contact(actuator: StepperScene, contact: ContactFit) -> tuple[Check, Check]:
    """Judge finger and backlash; warn where the ramp does not determine them."""
    expected = actuator.fingertip_n_per_m
    finger = grade(
        "finger",
        f"{contact.finger_n_per_m:.4g} ± {contact.finger_half_width:.2g} N/m,"
        f" first touch at {contact.touch_m * 1e6:+z.0f} µm",
        abs(contact.finger_n_per_m / expected - 1),
        FINGER_WARN,
        np.inf,
        f"the scene has {expected:.4g} N/m",
    )
    tolerance_m = max(2 * contact.backlash_half_width, 2 * actuator.step_m)
    backlash = grade(
        "backlash",
        f"{contact.backlash_m * 1e6:z.1f} ± {contact.backlash_half_width * 1e6:.1f} µm"
        f" (tolerance {tolerance_m * 1e6:.1f} µm)",
        abs(contact.backlash_m - actuator.backlash_m),
        tolerance_m,
        np.inf,
        f"the scene has {actuator.backlash_m * 1e6:g} µm",
    )
    if contact.unexplained > UNEXPLAINED_FAIL:
        reason = f"the ramp does not fit a finger: {contact.unexplained * 100:.0f} % unexplained"
        finger, backlash = (
            replace(each, verdict="fail", reason=reason) for each in (finger, backlash)
        )
        return finger, backlash
    if contact.finger_half_width > MAX_HALF_WIDTH * contact.finger_n_per_m:
        finger = with_warning(finger, "the ramp does not determine it: press with more force")
    if contact.backlash_m < -tolerance_m:
        reason = (
            "below 0: force on the way out exceeds that on the way in; check the film and its zero"
        )
        backlash = replace(backlash, verdict="warn", reason=reason)
    return finger, backlash


def check_latency(
    actuator: StepperScene,
    identified: IdentifiedModel,
    contact: ContactFit,
    latency_s: float,
    *,
    line_latency_s: float,
    tick_s: float,
) -> tuple[Check, bool]:
    """Judge a latency from a command to its motion.

    Parameters
    ----------
    latency_s : float
        The identified latency, without the film's share.
    line_latency_s : float
        Transmission time of a command on the bus or serial line; 0 for a model.
    tick_s : float
        Tick of the press. A latency is found to a quarter of a tick.

    Returns
    -------
    Check
        The latency against the scene's.
    bool
        False for a value that no drive can have, not to be written into a scene.
    """
    expected_s = actuator.latency_ns * 1e-9
    name, text = "drive's latency", f"{latency_s * 1e3:z.2f} ms from a command to its motion"
    if latency_s < -tick_s or math.isnan(latency_s):
        reason = "the motion comes before its command: look at the film's time stamps"
        return Check(name, text, "fail", reason), False
    if identified.delay_s >= MAX_LATENCY_S - tick_s:
        reason = f"longer than the search range of {MAX_LATENCY_S * 1e3:g} ms"
        return Check(name, text, "fail", reason), False
    early_s, reason = -EARLY_TICKS * tick_s, _fit_warning(identified)
    if latency_s < early_s:
        reason = reason or "the motion comes before its command: the film's time stamps are early"
    elif latency_s < line_latency_s + early_s or latency_s < TINY_LATENCY_S < line_latency_s:
        reason = reason or f"transmission on the line alone takes {line_latency_s * 1e3:.2f} ms"
    elif "latency" in identified.undetermined and _rotor_determined(identified, contact):
        reason = reason or "the record does not determine it"
    if reason:
        return Check(name, text, "warn", reason), False
    ticks = LATENCY_WARN_BACKLASH_TICKS if contact.has_backlash else LATENCY_WARN_TICKS
    off_s = abs(latency_s - expected_s)
    reason = f"the scene has {expected_s * 1e3:g} ms"
    return grade(name, text, off_s, tick_s * ticks, np.inf, reason), True
