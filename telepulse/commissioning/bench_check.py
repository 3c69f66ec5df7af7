"""`telepulse bench`: which checks a scene asks for, on its models or on the bench itself.

A scene's sensors while nothing presses, as models: what the live ones say is in `hardware`.

What a bench check found, as tables and plots.
"""

import math
import sys
import tomllib
from collections import Counter
from collections.abc import Iterator
from contextlib import closing, contextmanager
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from display_node.drives import build_drive
from display_node.drives.scene import Cia402Scene, TmclScene
from display_node.fault_advice import advised
from display_node.plant.stepper import StepperScene
from display_node.scene import DisplayScene
from protocol.config.scene import validate
from protocol.errors import BenchError, DriveError, SceneError, SourceError
from pulse_sensors.force_scale import SensorTable
from pulse_sensors.scene import open_sensor
from pulse_sensors.sensor import Sensor
from sensing_node.scene import SensingScene, build_source
from sensing_node.sources.synthetic import SyntheticScene
from telepulse.commissioning.actuator_check import ActuatorFindings, check_actuator
from telepulse.commissioning.identification import NAMES, respond, step_response
from telepulse.commissioning.press import PressRecord
from telepulse.commissioning.rig import (
    HardwareRig,
    ModelRig,
    check_answers,
    check_line,
    exchange_s,
    listen,
)
from telepulse.commissioning.scene_edit import Changes, set_keys
from telepulse.commissioning.sensor_check import Check, SensorRecord, grade, judge_sensor, measure
from telepulse.commissioning.tuning import MOST_SENSITIVITY, Design, design, judge, report_design
from telepulse.reports.document import Chapter, Plot, Report, Table

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def still_source(scene: SensingScene, folder: Path, seconds: float) -> SensorRecord:
    """A synthetic source without its pulse, heard through the scene's conditioning.

    Raises BenchError for a recording: there is no sensor to check.
    """
    if not isinstance(scene.source, SyntheticScene):
        raise BenchError("a recording cannot be still")
    still = {"peak_to_peak_n": 0.0, "preload_n": 0.0}
    changes: dict[str, object] = {"source": scene.source.model_copy(update=still)}
    if scene.conditioning is not None:
        changes["conditioning"] = scene.conditioning.model_copy(update={"hold_down_n": 0.0})
    source = build_source(scene.model_copy(update=changes), folder)
    count = round(seconds * 1e9 / source.period_ns)
    times_ns = np.arange(count) * source.period_ns
    return SensorRecord(times_ns, source.take(count)[:, 0], times_ns, np.ones(count, np.int64))


def still_film(pressed: PressRecord) -> SensorRecord:
    """What the film said before anything moved, a sample a batch."""
    at_s, force_n = pressed.film(pressed.still)
    times_ns = np.round(at_s * 1e9).astype(np.int64)
    return SensorRecord(times_ns, force_n, times_ns, np.ones(len(at_s), np.int64))


# A design keeps Ms at the limit itself; this much above is not worth a look.
ROUNDING = 1.01
# A press commands the drive once in so many exchanges on its line: answers take their turn.
UNHURRIED = 2.5
# The loop makes good what it knows of, but no scene's `latency` may be longer than the most.
LATE_FILM_AGE_S, MOST_FILM_AGE_S = 0.02, 0.05


@dataclass(slots=True)
class BenchFindings:
    """The results of the checks, each named by the part of the bench that was checked.

    still: what the sensors said while nothing pressed; design: the scene's own gains and the
    proposed ones on what was identified. modelled: the scene names no drive, and it was its models
    that were checked.
    """

    checks: list[tuple[str, Check]] = field(default_factory=list)
    still: dict[str, SensorRecord] = field(default_factory=dict)
    actuator: ActuatorFindings | None = None
    changes: Changes = field(default_factory=dict)
    designs: tuple[Design, Design] | None = None
    modelled: bool = False

    @property
    def failed(self) -> bool:
        """True where any check failed."""
        return any(check.verdict == "fail" for _, check in self.checks)

    @property
    def note(self) -> str:
        """Eq 22 as it was identified, for the written scene; "" where the keys have it."""
        if self.actuator is None or self.actuator.contact is None:
            return ""
        m, c, k, _ = self.actuator.identified.values
        return f"# Eq 22 from commanded to felt force: m = {m:.4g} s², c = {c:.4g} s, k = {k:.4g}"

    def add(self, part: str, *checks: Check) -> None:
        """Keep checks of a part."""
        self.checks += [(part, check) for check in checks]

    @contextmanager
    def part(self, part: str) -> Iterator[None]:
        """Add whatever ends a part's checks early as a check that failed."""
        try:
            yield
        except (BenchError, DriveError, SourceError) as error:
            self.add(part, Check("ended early", "", "fail", str(error)))


def check_wrist(findings: BenchFindings, scene: SensingScene, folder: Path, seconds: float) -> None:
    """Check the sensing node's sensor, on which nothing presses."""
    with findings.part("wrist"):
        if isinstance(scene.source, SensorTable):
            unloaded = scene.source.model_copy(update={"preload_n": 0.0})
            with closing(open_sensor(unloaded, folder, print)) as sensor:
                heard = listen(sensor, seconds)
        else:
            heard = still_source(scene, folder, seconds)
        live = isinstance(scene.source, SensorTable)
        _check_still(findings, "wrist", heard, scene.source.rate_hz, live)


def check_display(
    findings: BenchFindings, scene: DisplayScene, folder: Path, force_n: float, seconds: float
) -> None:
    """Check film and actuator: as the scene models them in virtual time, or the drive that the
    scene names and the film under its finger. The drive moves, and ends at rest."""
    if scene.drive is not None:
        _check_drive(findings, scene, scene.drive, folder, force_n, seconds)
        return
    findings.modelled = True
    with findings.part("actuator"):
        film_age_s = scene.film.latency_ns * 1e-9
        actuator = check_actuator(ModelRig(scene), scene, force_n, film_age_s)
        _check_still(
            findings, "film", still_film(actuator.pressed), 1e9 / scene.tick_ns, live=False
        )
        _keep(findings, actuator)


def _check_drive(
    findings: BenchFindings,
    scene: DisplayScene,
    table: TmclScene | Cia402Scene,
    folder: Path,
    force_n: float,
    seconds: float,
) -> None:
    actuator, film, tick_s = scene.actuator, scene.feedback, scene.tick_ns * 1e-9
    drive = build_drive(table, actuator, scene.layer.layer(), scene.safety.force_limit_n)
    if film is None or not isinstance(actuator, StepperScene):
        raise SceneError("[display.feedback] is missing: a drive is checked by what it presses")
    findings.add("drive", check_line(table, tick_s))
    with findings.part("film"), closing(open_sensor(film, folder, print)) as sensor:
        with findings.part("drive"), closing(drive):
            with advised():
                drive.start(partial(_newest_n, sensor))
            age_s = _check_still(findings, "film", listen(sensor, seconds), film.rate_hz, live=True)
            findings.add("film", _check_age(age_s))
            findings.add("drive", check_answers(drive))
            # A command that is superseded before it was sent is way that is not made.
            rig = HardwareRig(drive, sensor, max(tick_s, UNHURRIED * exchange_s(table)))
            try:
                found = check_actuator(
                    rig, scene, force_n, 0.0, least_latency_s=exchange_s(table) / 2
                )
            except KeyboardInterrupt:
                rig.retreat()
                raise
            # Read at this age, a sample is there when the loop asks for it.
            latency_s = min(math.ceil(age_s / tick_s) * tick_s, MOST_FILM_AGE_S)
            findings.changes["display.film"] = {"latency": f'"{latency_s * 1e3:g} ms"'}
            _keep(findings, found)
        # Commands that a newer one superseded are what a line slower than the loop makes.
        for name, count in sorted((drive.counts - Counter(superseded=sys.maxsize)).items()):
            findings.add("drive", Check(name, f"{count} times", "look", "on the way to the drive"))


def _newest_n(sensor: Sensor) -> float | None:
    """The newest reading in N since the last call; None where none came."""
    readings = sensor.poll()
    return readings[-1].force_n[-1] if readings else None


def _check_age(age_s: float) -> Check:
    found = f"the newest sample is up to {age_s * 1e3:.1f} ms old (99 %)"
    if age_s < 0:
        reason = "younger than 0: the device's times are ahead of this machine's clock"
        return Check("age of a reading", found, "fail", reason)
    reason = "let the device send smaller batches; on USB look at the adapter's latency timer"
    return grade("age of a reading", found, age_s, LATE_FILM_AGE_S, MOST_FILM_AGE_S, reason)


def check_loop(findings: BenchFindings, path: Path) -> None:
    """Margins of the force loop, with the scene's gains, on what was identified, if it was."""
    if findings.actuator is None:
        return
    text = set_keys(path.read_text(encoding="utf-8"), findings.changes)
    try:
        found = validate(tomllib.loads(text)["display"], DisplayScene, f"{path}: [display]")
    except SceneError as error:
        # What was found is no value of a scene: the other checks stand all the same.
        findings.add("loop", Check("margins", "", "fail", str(error)))
        return
    present, proposed = judge(found, found.controller), design(found)
    findings.designs = present, proposed
    worst = present.worst
    shown = f"Ms {worst.peak_sensitivity:.2f}, delay margin {worst.delay_s * 1e3:.3g} ms"
    if worst.unfit is not None:
        findings.add(
            "loop", Check("margins", shown, "fail", f"{worst.unfit}: take the gains below")
        )
    elif worst.peak_sensitivity > MOST_SENSITIVITY * ROUNDING:
        reason = f"a design keeps Ms below {MOST_SENSITIVITY}: see the design below"
        findings.add("loop", Check("margins", shown, "look", reason))
    else:
        findings.add("loop", Check("margins", shown))


def _check_still(
    findings: BenchFindings, part: str, heard: SensorRecord, nominal_hz: float, live: bool
) -> float:
    """Check what a sensor said; how old its newest sample is at worst, in s."""
    findings.still[part] = heard
    figures = measure(heard)
    findings.add(part, *judge_sensor(figures, nominal_hz, live))
    return figures.age_s


def _keep(findings: BenchFindings, actuator: ActuatorFindings) -> None:
    findings.actuator = actuator
    findings.add("actuator", *actuator.checks)
    for table, keys in actuator.changes.items():
        findings.changes.setdefault(table, {}).update(keys)


_UNITS = {"m": (1.0, ""), "c": (1.0, ""), "k": (1.0, ""), "latency": (1e3, " ms")}


def report_bench(name: str, findings: BenchFindings) -> Report:
    """The report of a bench check."""
    rows = tuple(
        (part, check.name, check.found, check.verdict, check.reason)
        for part, check in findings.checks
    )
    modelled = ": its models, as it names no [display.drive]" if findings.modelled else ""
    checks = Table(f"bench of {name}{modelled}", ("part", "check", "found", "verdict", "why"), rows)
    still = tuple(_still_plot(part, heard) for part, heard in findings.still.items())
    chapters = [Chapter("Checks", tables=(checks,), plots=still)]
    if findings.actuator is not None:
        chapters.append(_actuator_chapter(findings.actuator))
    if findings.designs is not None:
        chapters += report_design(f"{name}, as identified", *findings.designs).chapters
    return Report(f"Bench of {name}", tuple(chapters))


def _actuator_chapter(actuator: ActuatorFindings) -> Chapter:
    found = actuator.identified
    rows = []
    for name, value, within in zip(NAMES, found.values, found.within, strict=True):
        scale, unit = _UNITS[name]
        told = "not told by the record" if name in found.untold else ""
        rows.append((name, f"{value * scale:.4g}{unit}", f"{within * scale:.2g}{unit}", told))
    rows.append(("delay of slow changes, latency + c/k", f"{found.delay_s * 1e3:.3g} ms", "", ""))
    if "m" not in found.untold:
        answer = step_response(found.model)
        rows += [
            ("resonance", f"{found.model.resonance_hz:.4g} Hz", "", ""),
            ("damping ζ", f"{found.model.damping:.3g}", "", ""),
            ("rise, 10 to 90 %", f"{answer.rise_s * 1e3:.3g} ms", "", ""),
            ("overshoot", f"{answer.overshoot * 100:.0f} %", "", ""),
            ("settling to 2 %", f"{answer.settling_s * 1e3:.3g} ms", "", ""),
        ]
    table = Table(
        "actuator, g(s) = 1 / (m s² + c s + k) (eq 22)",
        ("", "identified", "± (95 %)", ""),
        tuple(rows),
        note=_INPUT[actuator.contact is None],
    )
    return Chapter("ActuatorFindings", tables=(table,), plots=(_stairs_plot(actuator),))


_INPUT = {
    True: "from the voltage to the force; the film's filter is taken out",
    False: "from the force that the commanded place presses with at rest, by the contact found"
    " here, to the force felt: c in s, m in s²; the film's filter is taken out",
}


def _stairs_plot(actuator: ActuatorFindings) -> Plot:
    def draw(figure: "Figure") -> None:
        at_s, force_n = actuator.pressed.film(actuator.pressed.stairs)
        fitted_n = respond(actuator.identified.model, actuator.told, at_s)
        fitted_n += actuator.identified.zero_n
        force, left = figure.subplots(2, sharex=True, height_ratios=(3, 1))
        force.plot(at_s, force_n, label="film")
        force.plot(at_s, fitted_n, "--", label="eq 22, fitted")
        force.set(ylabel="force in N")
        force.legend(loc="upper left")
        left.plot(at_s, 1e3 * (force_n - fitted_n))
        left.set(xlabel="time in s", ylabel="left over, mN")

    return Plot("stairs", "The staircase: what the film said, and the fitted model.", draw)


def _still_plot(part: str, heard: SensorRecord) -> Plot:
    def draw(figure: "Figure") -> None:
        from scipy.signal import welch

        rate_hz = 1e9 / float(np.diff(heard.taken_ns).mean())
        count = min(len(heard.force_n), 1024)
        frequency_hz, density = welch(heard.force_n, rate_hz, nperseg=count)
        axes = figure.subplots()
        axes.semilogy(frequency_hz[1:], 1e3 * np.sqrt(np.maximum(density[1:], 1e-24)))
        axes.set(xlabel="frequency in Hz", ylabel="noise in mN/√Hz")

    return Plot(f"noise-{part}", f"Noise of the {part}'s sensor while nothing presses.", draw)
