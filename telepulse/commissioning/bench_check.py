"""`telepulse bench`: the checks of a scene on its models or on the real bench, and their report."""

import math
import time
from collections.abc import Iterator
from contextlib import closing, contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from display_node.benches import open_film
from display_node.hardware import build_display_drive
from display_node.scene import DisplayScene
from protocol.config.scene import validate
from protocol.config.scene_file import load_document, merge
from protocol.errors import BenchError, DriveError, SceneError, SourceError
from pulse_drives.scene import DriveScene
from pulse_drives.start_advice import advised
from pulse_sensors.sensor import open_sensor
from sensing_node.scene import SensingScene, build_source
from telepulse.commissioning.actuator_check import ActuatorFindings, check_actuator
from telepulse.commissioning.identification import NAMES, respond, step_response
from telepulse.commissioning.rig import (
    HardwareRig,
    ModelRig,
    check_answers,
    check_line,
    judge_line_errors,
    listen,
)
from telepulse.commissioning.scene_edit import Changes
from telepulse.commissioning.sensor_check import (
    Check,
    SensorRecord,
    grade,
    judge_sensor,
    of_each_force,
    reading_age_s,
)
from telepulse.commissioning.tuning import MOST_SENSITIVITY, Design, design, judge, report_design
from telepulse.document import Chapter, Plot, Report, Table

if TYPE_CHECKING:
    from matplotlib.figure import Figure

# A design may have Ms at the limit itself: rounding errors above it are no reason for a warning.
ROUNDING = 1.01
# A press sends one command in the time of this many exchanges: the line then carries all answers.
EXCHANGES_PER_TICK = 2.5
# Age of the film's readings. The loop compensates a known age, but a scene's `latency` is at most
# the second value.
FILM_AGE_WARN_S, FILM_AGE_FAIL_S = 0.02, 0.05
# Of a sensor that was opened just now: until then its times follow the estimate of its clock.
SETTLED_S = 1.0


@dataclass(slots=True)
class BenchFindings:
    """The results of the checks.

    checks: pairs of a part of the bench and its check. still: sensor records while nothing
    pressed, by part. changes: identified keys of the scene. designs: the scene's own gains and the
    proposed ones, with the identified actuator. modelled: the scene names no drive, so its models
    were checked.
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
        """Line of a comment with eq 22; "" where the scene has keys for m, c and k."""
        if self.actuator is None or self.actuator.contact is None:
            return ""
        m, c, k, _ = self.actuator.identified.values
        found = f"m = {m:.4g} s², c = {c:.4g} s, k = {k:.4g}"
        return f"# Eq 22 from commanded to felt force: {found}\n"

    def add(self, part: str, *checks: Check) -> None:
        """Add checks of a part."""
        self.checks += [(part, check) for check in checks]

    def add_actuator(self, actuator: ActuatorFindings) -> None:
        """Add the checks and the changes of an identified actuator."""
        self.actuator = actuator
        self.add("actuator", *actuator.checks)
        if actuator.keys:
            self.changes["actuator"] = actuator.keys

    def add_still(self, part: str, record: SensorRecord, nominal_hz: float, live: bool) -> None:
        """Add the checks of a sensor."""
        self.still[part] = record
        self.add(part, *judge_sensor(record, nominal_hz, live))

    @contextmanager
    def part(self, part: str) -> Iterator[None]:
        """If an error ends a part's checks early, add it as a failed check."""
        try:
            yield
        except (BenchError, DriveError, SourceError) as error:
            self.add(part, Check("ended early", "", "fail", str(error)))


def check_wrist(findings: BenchFindings, scene: SensingScene, folder: Path, seconds: float) -> None:
    """Check each channel of force of the sensing node's sensor, on which nothing presses."""
    with findings.part("wrist"):
        if scene.sensor is not None:
            unloaded = scene.sensor.model_copy(update={"preload_n": 0.0})
            rate_hz = unloaded.rate_hz
            with closing(open_sensor(unloaded, folder)) as sensor:
                time.sleep(SETTLED_S)
                records = listen(sensor, seconds)
        else:
            rate_hz, records = _still_source(scene, folder, seconds)
        for name, record in records.items():
            part = f"wrist, {name}" if len(records) > 1 else "wrist"
            findings.add_still(part, record, rate_hz, live=scene.sensor is not None)


def _still_source(
    scene: SensingScene, folder: Path, seconds: float
) -> tuple[float, dict[str, SensorRecord]]:
    """Return the rate in Hz of a source without its pulse, and its records.

    They are those behind the conditioning. Raises BenchError for a source that has a pulse always,
    such as a recording: there is no sensor to check.
    """
    still = scene.still()
    if still is None:
        raise BenchError(f"[sensing.source] is a {scene.source.kind}: there is no sensor to check")
    source = build_source(still, folder)
    count = round(seconds * 1e9 / source.period_ns)
    times_ns = np.arange(count) * source.period_ns
    values = source.take(count)
    record = SensorRecord(times_ns, values[:, 0], times_ns, np.ones(count, np.int64))
    return 1e9 / source.period_ns, of_each_force(record, values, source.channels)


def check_display(
    findings: BenchFindings, scene: DisplayScene, folder: Path, force_n: float, seconds: float
) -> None:
    """Check film and actuator: the scene's models in virtual time, or its drive and its film.

    A drive moves, and ends at rest.
    """
    if scene.drive is not None:
        _check_drive(findings, scene, scene.drive, folder, force_n, seconds)
        return
    findings.modelled = True
    with findings.part("actuator"):
        film_age_s = scene.film.latency_ns * 1e-9
        actuator = check_actuator(ModelRig(scene), scene, force_n, film_age_s)
        # Readings of the modelled film before the first motion, as batches of one sample.
        at_s, read_n = actuator.pressed.film(actuator.pressed.still)
        times_ns = np.round(at_s * 1e9).astype(np.int64)
        record = SensorRecord(times_ns, read_n, times_ns, np.ones(len(at_s), np.int64))
        findings.add_still("film", record, 1e9 / scene.tick_ns, live=False)
        findings.add_actuator(actuator)


def _check_drive(
    findings: BenchFindings,
    scene: DisplayScene,
    table: DriveScene,
    folder: Path,
    force_n: float,
    seconds: float,
) -> None:
    actuator, film, tick_s = scene.actuator, scene.feedback, scene.tick_ns * 1e-9
    drive = build_display_drive(table, actuator, scene.layer.layer(), scene.safety.force_limit_n)
    if film is None:
        raise SceneError(
            "[display.feedback] is missing: a drive is checked by the force on the film"
        )
    findings.add("drive", check_line(table, tick_s))
    line_s = table.exchange_s or 0.0
    with (
        findings.part("film"),
        closing(open_film(film, drive, scene.safety.overforce_n, folder)) as sensor,
    ):
        with findings.part("drive"), closing(drive):
            with advised():
                # The newest reading since the last call, if any.
                drive.start(lambda: next((r.force_n[-1] for r in reversed(sensor.poll())), None))
            record = next(iter(listen(sensor, seconds).values()))
            findings.add_still("film", record, film.rate_hz, live=True)
            age_s = reading_age_s(record)
            findings.add("film", _check_age(age_s))
            findings.add("drive", check_answers(drive))
            # Slow enough that no command is superseded: the travel of one would be missing.
            rig = HardwareRig(drive, sensor, max(tick_s, EXCHANGES_PER_TICK * line_s))
            try:
                found = check_actuator(rig, scene, force_n, 0.0, line_latency_s=line_s / 2)
            except KeyboardInterrupt:
                rig.withdraw()
                raise
            # Whole ticks: at this age a sample has always arrived when the loop reads it.
            latency_s = min(math.ceil(age_s / tick_s) * tick_s, FILM_AGE_FAIL_S)
            findings.changes["film"] = {"latency": f"{latency_s * 1e3:g} ms"}
            findings.add_actuator(found)
        findings.add("drive", *judge_line_errors(drive.counts))


def _check_age(age_s: float) -> Check:
    name, text = "age of a reading", f"the newest sample is up to {age_s * 1e3:.1f} ms old (99 %)"
    if age_s < 0:
        reason = "younger than 0: the device's times are ahead of this machine's clock"
        return Check(name, text, "fail", reason)
    reason = "let the device send smaller batches; on USB lower the adapter's latency timer"
    return grade(name, text, age_s, FILM_AGE_WARN_S, FILM_AGE_FAIL_S, reason)


def check_loop(findings: BenchFindings, path: Path, contactor: str | None = None) -> None:
    """Check the margins of the scene's gains on the identified actuator, where there is one."""
    if findings.actuator is None:
        return
    table = load_document(path)["display"]
    try:
        if "contactor" in table:
            names = [each.shown_name for each in validate(table, DisplayScene, "").contactor]
            changed = table["contactor"][names.index(contactor or names[0])]
            changed.update(merge(changed, findings.changes))
        else:
            table = merge(table, findings.changes)
        found = validate(table, DisplayScene, f"{path}: [display]").choose(contactor)
    except SceneError as error:
        # An identified value is outside a scene's bounds; the other checks remain valid.
        findings.add("loop", Check("margins", "", "fail", str(error)))
        return
    present, proposed = judge(found, found.controller), design(found)
    findings.designs = present, proposed
    worst = present.worst
    shown = f"Ms {worst.peak_sensitivity:.2f}, delay margin {worst.delay_s * 1e3:.3g} ms"
    reason = f"a design keeps Ms below {MOST_SENSITIVITY}: see the design below"
    most = MOST_SENSITIVITY * ROUNDING
    check = grade("margins", shown, worst.peak_sensitivity, most, math.inf, reason)
    if worst.unfit is not None:
        check = Check("margins", shown, "fail", f"{worst.unfit}: use the gains below")
    findings.add("loop", check)


def report_bench(name: str, findings: BenchFindings) -> Report:
    """Return the report of a bench check."""
    rows = tuple(
        (part, check.name, check.text, check.verdict, check.reason)
        for part, check in findings.checks
    )
    modelled = ": its models, since it has no [display.drive]" if findings.modelled else ""
    checks = Table(f"bench of {name}{modelled}", ("part", "check", "found", "verdict", "why"), rows)
    still = tuple(_noise_plot(part, record) for part, record in findings.still.items())
    chapters = [Chapter("Checks", tables=(checks,), plots=still)]
    if findings.actuator is not None:
        chapters.append(_actuator_chapter(findings.actuator))
    if findings.designs is not None:
        chapters += report_design(f"{name}, as identified", *findings.designs).chapters
    return Report(f"Bench of {name}", tuple(chapters))


def _actuator_chapter(actuator: ActuatorFindings) -> Chapter:
    found = actuator.identified
    rows = []
    for name, value, half_width in zip(NAMES, found.values, found.half_widths, strict=True):
        scale, unit = (1e3, " ms") if name == "latency" else (1.0, "")
        remark = "not determined by the record" if name in found.undetermined else ""
        rows.append((name, f"{value * scale:.4g}{unit}", f"{half_width * scale:.2g}{unit}", remark))
    rows.append(("delay of slow changes, latency + c/k", f"{found.delay_s * 1e3:.3g} ms", "", ""))
    if "m" not in found.undetermined:
        rise_s, overshoot, settling_s = step_response(found.model)
        rows += [
            ("resonance", f"{found.model.resonance_hz:.4g} Hz", "", ""),
            ("damping ζ", f"{found.model.damping:.3g}", "", ""),
            ("rise, 10 to 90 %", f"{rise_s * 1e3:.3g} ms", "", ""),
            ("overshoot", f"{overshoot * 100:.0f} %", "", ""),
            ("settling to 2 %", f"{settling_s * 1e3:.3g} ms", "", ""),
        ]
    note = (
        "from the voltage to the force; the film's filter is compensated"
        if actuator.contact is None
        else "from the static force at the commanded position (by the contact law identified here)"
        " to the felt force; c in s, m in s²; the film's filter is compensated"
    )
    table = Table(
        "actuator, g(s) = 1 / (m s² + c s + k) (eq 22)",
        ("", "identified", "± (95 %)", ""),
        tuple(rows),
        note=note,
    )
    return Chapter("Actuator", tables=(table,), plots=(_stairs_plot(actuator),))


def _stairs_plot(actuator: ActuatorFindings) -> Plot:
    def draw(figure: "Figure") -> None:
        at_s, force_n = actuator.pressed.film(actuator.pressed.stairs)
        fitted_n = respond(actuator.identified.model, actuator.command, at_s)
        fitted_n += actuator.identified.zero_n
        force, residual = figure.subplots(2, sharex=True, height_ratios=(3, 1))
        force.plot(at_s, force_n, label="film")
        force.plot(at_s, fitted_n, "--", label="eq 22, fitted")
        force.set(ylabel="force in N")
        force.legend(loc="upper left")
        residual.plot(at_s, 1e3 * (force_n - fitted_n))
        residual.set(xlabel="time in s", ylabel="residual in mN")

    return Plot("stairs", "The staircase: readings of the film, and the fitted model.", draw)


def _noise_plot(part: str, record: SensorRecord) -> Plot:
    def draw(figure: "Figure") -> None:
        from scipy.signal import welch

        rate_hz = 1e9 / float(np.diff(record.taken_ns).mean())
        count = min(len(record.force_n), 1024)
        frequency_hz, density = welch(record.force_n, rate_hz, nperseg=count)
        axes = figure.subplots()
        axes.semilogy(frequency_hz[1:], 1e3 * np.sqrt(np.maximum(density[1:], 1e-24)))
        axes.set(xlabel="frequency in Hz", ylabel="noise in mN/√Hz")

    return Plot(f"noise-{part}", f"Noise of the {part}'s sensor while nothing presses.", draw)
