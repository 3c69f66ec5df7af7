"""`telepulse bench`: which checks a scene asks for, on its models or on the bench itself.

A scene's sensors while nothing presses, as models: what the live ones say is in `hardware`.
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
from telepulse.commissioning.actuator_check import Actuator, check_actuator
from telepulse.commissioning.check import Check, graded
from telepulse.commissioning.hardware import (
    HardwareRig,
    check_answers,
    check_line,
    exchange_s,
    listen,
)
from telepulse.commissioning.press import Pressed
from telepulse.commissioning.rig import ModelRig
from telepulse.commissioning.scene_edit import Changes, set_keys
from telepulse.commissioning.sensor_check import SensorRecord, judge_sensor, measure
from telepulse.commissioning.tuning import MOST_SENSITIVITY, Design, design, judge


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


def still_film(pressed: Pressed) -> SensorRecord:
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
    actuator: Actuator | None = None
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
    vco = actuator.step_rate()
    findings.add("drive", check_line(table, tick_s))
    with findings.part("film"), closing(open_sensor(film, folder, print)) as sensor:
        with findings.part("drive"), closing(drive):
            with advised():
                drive.start(partial(_newest_n, sensor))
            age_s = _check_still(findings, "film", listen(sensor, seconds), film.rate_hz, live=True)
            findings.add("film", _check_age(age_s))
            findings.add("drive", check_answers(drive, vco))
            # A command that is superseded before it was sent is way that is not made.
            rig = HardwareRig(drive, sensor, vco, max(tick_s, UNHURRIED * exchange_s(table)))
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
    return graded("age of a reading", found, age_s, LATE_FILM_AGE_S, MOST_FILM_AGE_S, reason)


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


def _keep(findings: BenchFindings, actuator: Actuator) -> None:
    findings.actuator = actuator
    findings.add("actuator", *actuator.checks)
    for table, keys in actuator.changes.items():
        findings.changes.setdefault(table, {}).update(keys)
