"""The actuator pressed and identified: what a scene should say of it, and what it says."""

import copy
import math
from dataclasses import dataclass

import numpy as np

from display_node.plant.contact import ContactLaw
from display_node.plant.film import FilmTable
from display_node.plant.second_order import SecondOrderScene
from display_node.plant.stepper import StepperScene
from display_node.scene import DisplayScene
from telepulse.commissioning.identification import TOLD, ActuatorInput, IdentifiedModel, identify
from telepulse.commissioning.press import (
    GUARD,
    ContactFit,
    PressPhase,
    PressRecord,
    PressRecorder,
    fit_contact,
    press_stepper,
    press_voltage,
    through_film,
)
from telepulse.commissioning.rig import Rig
from telepulse.commissioning.scene_edit import Changes
from telepulse.commissioning.sensor_check import Check, grade, with_warning

LONGEST_LATENCY_S = 0.05
# Twice: the latency is needed for the play, and the play for the latency.
ROUNDS = 2
# RMS of what eq 22 does not explain, over the whole change.
UNEXPLAINED_LOOK, UNEXPLAINED_FAIL = 0.1, 0.3
FINGER_LOOK = 0.2
WAY_LOOK, WAY_FAIL = 0.05, 0.5
# A sensor's stamps may be early by some of a tick: nothing tells when its first byte was sent.
EARLY_TICKS = 0.25
# Below it a fit has ended at its bound of 0.
TINY_LATENCY_S = 1e-6
LATENCY_LOOK_TICKS, LATENCY_LOOK_PLAY_TICKS = 1.0, 2.0


@dataclass(frozen=True, slots=True)
class ActuatorFindings:
    """The results for an actuator: commands and film of the staircase, the fit, the contact (of a
    stepper)."""

    pressed: PressRecord
    told: ActuatorInput
    identified: IdentifiedModel
    contact: ContactFit | None
    checks: tuple[Check, ...]
    changes: Changes


def check_actuator(
    rig: Rig,
    scene: DisplayScene,
    force_n: float,
    film_age_s: float,
    least_latency_s: float = 0.0,
) -> ActuatorFindings:
    """Press with at most force_n and identify. Raises BenchError.

    film_age_s: how much of the latency is the film's. The proposed scene gives the actuator the
    rest. least_latency_s: how long a command takes on its line alone.
    """
    if isinstance(scene.actuator, SecondOrderScene):
        return _check_voltage(rig, scene, scene.actuator, force_n)
    return _check_stepper(rig, scene, scene.actuator, force_n, film_age_s, least_latency_s)


def _check_voltage(
    rig: Rig, scene: DisplayScene, actuator: SecondOrderScene, force_n: float
) -> ActuatorFindings:
    pressed = press_voltage(_recorder(rig, scene, force_n), actuator, force_n)
    told = through_film(pressed.told(pressed.stairs, held=True), scene.film)
    found = identify(told, *pressed.film(pressed.stairs), LONGEST_LATENCY_S)
    values = dict(zip("mck", found.values, strict=False))
    keys = {key: f"{value:.4g}" for key, value in values.items()}
    changes = {"display.actuator": keys} if _fits(found) else {}
    return ActuatorFindings(pressed, told, found, None, (_check_fit(found),), changes)


def _recorder(rig: Rig, scene: DisplayScene, force_n: float) -> PressRecorder:
    return PressRecorder(rig, GUARD * force_n, scene.safety.feedback_within_ns * 1e-9)


def _check_stepper(
    rig: Rig,
    scene: DisplayScene,
    actuator: StepperScene,
    force_n: float,
    film_age_s: float,
    least_latency_s: float,
) -> ActuatorFindings:
    pressed = press_stepper(_recorder(rig, scene, force_n), actuator, force_n)
    law, lag_s = actuator.contact(scene.layer.layer()), 0.0
    for _ in range(ROUNDS):
        contact = fit_contact(pressed, law, scene.film, lag_s)
        fitted = copy.copy(law)
        fitted.finger_m_per_n = 1 / contact.finger_n_per_m
        told = _stairs(pressed, contact, fitted, scene.film)
        found = identify(told, *pressed.film(pressed.stairs), LONGEST_LATENCY_S)
        lag_s = found.delay_s
    latency_s = _latency_s(actuator, found, contact) - film_age_s
    latency = check_latency(
        actuator, found, contact, latency_s, least_latency_s=least_latency_s, tick_s=rig.tick_s
    )
    # A latency that cannot be is no figure for a scene.
    told_s = None if latency.doubtful else latency_s
    changes = _changes(actuator, found, contact, told_s) if _fits(found) else {}
    checks = (
        _check_fit(found),
        _check_way(found),
        *check_contact(actuator, contact),
        latency.check,
    )
    return ActuatorFindings(pressed, told, found, contact, checks, changes)


def _stairs(
    pressed: PressRecord, contact: ContactFit, law: ContactLaw, film: FilmTable
) -> ActuatorInput:
    """The force that was commanded in the staircase, behind the film's filter."""
    begin_s = pressed.recorder.told_s[0]
    way = pressed.told(PressPhase(begin_s, pressed.stairs.end_s), held=False)
    # Filtered from the press's beginning, so that the filter is settled when the stairs begin.
    seen = through_film(contact.pressed_n(law, way), film)
    first = round((pressed.stairs.begin_s - begin_s) / seen.tick_s)
    return ActuatorInput(seen.values[first:], seen.tick_s, held=False)


def _fits(found: IdentifiedModel) -> bool:
    """Return whether the fit is worth a place in a scene."""
    return found.nrmse <= UNEXPLAINED_FAIL


def _latency_s(actuator: StepperScene, found: IdentifiedModel, contact: ContactFit) -> float:
    """Return the time from a command to its motion, film's age included, as the scene's model has
    it: a rotor that the scene will have delays by its own 2 ζ/ω beside it."""
    if _rotor_told(found, contact):
        return found.model.latency_s
    if actuator.rotor_resonance_hz is None:
        return found.delay_s
    rotor_s = 2 * actuator.rotor_damping / (2 * math.pi * actuator.rotor_resonance_hz)
    return found.delay_s - rotor_s


def _rotor_told(found: IdentifiedModel, contact: ContactFit) -> bool:
    """Return whether the fitted resonance is the rotor's: play hides its way back."""
    return not {"m", "c"} & set(found.untold) and not _has_play(contact)


def _has_play(contact: ContactFit) -> bool:
    return contact.play_m > 2 * contact.play_within


def _changes(
    actuator: StepperScene, found: IdentifiedModel, contact: ContactFit, latency_s: float | None
) -> Changes:
    """Return the keys that the press determines; latency_s: None where it does not."""
    keys = {"fingertip": f'"{contact.finger_n_per_m:.4g} N/m"'}
    if _has_play(contact) and contact.play_m > actuator.step_m:
        keys["backlash"] = f'"{contact.play_m * 1e6:.3g} µm"'
    if _rotor_told(found, contact):
        keys["rotor_resonance"] = f'"{found.model.resonance_hz:.4g} Hz"'
        keys["rotor_damping"] = f"{found.model.damping:.3g}"
    if latency_s is not None:
        keys["latency"] = f'"{max(0.0, latency_s) * 1e3:.3g} ms"'
    return {"display.actuator": keys}


def _check_fit(found: IdentifiedModel) -> Check:
    check = grade(
        "eq 22",
        f"leaves {found.nrmse * 100:.1f} % of the force's change unexplained",
        found.nrmse,
        UNEXPLAINED_LOOK,
        UNEXPLAINED_FAIL,
        "the actuator is not of second order, or loses steps: look at the plot",
    )
    if check.verdict == "ok" and found.untold:
        names = ", ".join(found.untold)
        return Check(check.name, f"{check.found}; {names}: not told by the record")
    return check


def _check_way(found: IdentifiedModel) -> Check:
    check = grade(
        "way",
        f"a step goes {100 / found.model.k:.1f} % of the way it is told",
        abs(1 / found.model.k - 1),
        WAY_LOOK,
        WAY_FAIL,
        "commands or steps are lost on the way, or lead and microsteps are wrong",
    )
    untold = "the record does not determine it" if "k" in found.untold else ""
    return with_warning(check, _of_a_bad_fit(found) or untold)


def _of_a_bad_fit(found: IdentifiedModel) -> str:
    if _fits(found):
        return ""
    return f"of no meaning: eq 22 leaves {found.nrmse * 100:.0f} % unexplained"


def check_contact(actuator: StepperScene, contact: ContactFit) -> tuple[Check, ...]:
    """Judge finger and play, and whether the ramp determines them at all."""
    expected = actuator.fingertip_n_per_m
    finger = grade(
        "finger",
        f"{contact.finger_n_per_m:.4g} ± {contact.finger_within:.2g} N/m,"
        f" first touch at {contact.touch_m * 1e6:+.0f} µm",
        abs(contact.finger_n_per_m / expected - 1),
        FINGER_LOOK,
        np.inf,
        f"the scene says {expected:.4g} N/m",
    )
    off_m = abs(contact.play_m - actuator.backlash_m)
    play = grade(
        "play",
        f"{contact.play_m * 1e6:.1f} ± {contact.play_within * 1e6:.1f} µm",
        off_m,
        max(2 * contact.play_within, 2 * actuator.step_m),
        np.inf,
        f"the scene says {actuator.backlash_m * 1e6:g} µm",
    )
    if contact.unexplained > UNEXPLAINED_FAIL:
        reason = f"the ramp is not a finger's: {contact.unexplained * 100:.0f} % unexplained"
        return (
            Check(finger.name, finger.found, "fail", reason),
            Check(play.name, play.found, "fail", reason),
        )
    if contact.finger_within > TOLD * contact.finger_n_per_m:
        finger = with_warning(finger, "the ramp does not determine it: press with more force")
    if contact.play_m < -max(2 * contact.play_within, 2 * actuator.step_m):
        reason = "below 0: the way back presses more than the way in; look at film and zero"
        play = Check(play.name, play.found, "look", reason)
    return finger, play


def _tolerance_ticks(contact: ContactFit) -> float:
    """Play keeps the tip where the rotor swung to; what is fitted to that is late or early."""
    return LATENCY_LOOK_PLAY_TICKS if _has_play(contact) else LATENCY_LOOK_TICKS


@dataclass(frozen=True, slots=True)
class LatencyCheck:
    """The check of the latency; doubtful: it is no latency that a drive can have."""

    check: Check
    doubtful: bool


def check_latency(
    actuator: StepperScene,
    found: IdentifiedModel,
    contact: ContactFit,
    latency_s: float,
    *,
    least_latency_s: float,
    tick_s: float,
) -> LatencyCheck:
    """Judge a latency from a command to its motion: against the scene, and whether it can be.

    Parameters
    ----------
    latency_s : float
        As it was identified, without the film's share.
    least_latency_s : float
        How long a command takes on its line alone; 0 for a model.
    tick_s : float
        Of the press. A latency is found to a quarter of a tick.
    """
    expected_s = actuator.latency_ns * 1e-9
    text = f"{latency_s * 1e3:.2f} ms from a command to its motion"
    check = grade(
        "drive's latency",
        text,
        abs(latency_s - expected_s),
        tick_s * _tolerance_ticks(contact),
        np.inf,
        f"the scene says {expected_s * 1e3:g} ms",
    )
    early_s, bound_s = -EARLY_TICKS * tick_s, LONGEST_LATENCY_S - tick_s
    if latency_s < -tick_s or math.isnan(latency_s):
        reason = "the motion comes before its command: look at the film's time stamps"
        return LatencyCheck(Check(check.name, text, "fail", reason), True)
    if found.delay_s >= bound_s:
        reason = f"at the longest that is searched, {LONGEST_LATENCY_S * 1e3:g} ms"
        return LatencyCheck(Check(check.name, text, "fail", reason), True)
    reason = _of_a_bad_fit(found)
    if latency_s < early_s:
        reason = reason or "the motion comes before its command: the film's time stamps are early"
    elif latency_s < least_latency_s + early_s or latency_s < TINY_LATENCY_S < least_latency_s:
        reason = reason or f"its line alone takes {least_latency_s * 1e3:.2f} ms"
    elif "latency" in found.untold and _rotor_told(found, contact):
        reason = reason or "the record does not determine it"
    if not reason:
        return LatencyCheck(check, False)
    return LatencyCheck(Check(check.name, text, "look", reason), True)
