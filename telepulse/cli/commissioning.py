"""`telepulse bench`, `calibrate` and `tune`: putting a bench into service."""

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Annotated, Literal

import tomlkit
import typer

from display_node.benches import open_film
from display_node.hardware import build_display_drive
from display_node.scene import DisplayScene
from protocol.cli_options import BENCH_IS_CLEAR, LogLevelOption, one_line_errors, plain_console
from protocol.config.quantities import parse_quantity
from protocol.config.scene import Section, load_section
from protocol.config.scene_file import find_scene, scene_names
from protocol.errors import SceneError
from protocol.host.output import check_writable, configure_logging, write_whole
from protocol.provenance import collect
from pulse_sensors.drive_film import DriveFilmScene
from pulse_sensors.sensor import Sensor, open_sensor
from sensing_node.scene import SensingScene
from telepulse.cli.options import (
    KEEP_AWAY,
    PROGRAM,
    ContactorOption,
    PageOption,
    SceneArgument,
    TablesOption,
    YesOption,
    publish,
)
from telepulse.commissioning.calibration import (
    LoadReadings,
    LoadUnit,
    ReadingUnit,
    calibration_keys,
    fit_line,
    measure_loads,
    parse_loads,
    read_loads,
    report_calibration,
)
from telepulse.document import Report, print_tables, write_json
from telepulse.scene import DEFAULT_SCENE, load_scene

WARNING = "The drive will move and press with up to {force}. " + KEEP_AWAY


def bench(
    scene: SceneArgument = DEFAULT_SCENE,
    contactor: ContactorOption = None,
    only: Annotated[
        Literal["sensing", "display", "both"],
        typer.Option(help="The end that is on this machine."),
    ] = "both",
    force: Annotated[str, typer.Option(help="Largest force of the press.")] = "0.3 N",
    seconds: Annotated[
        float, typer.Option(min=1, max=3600, help="How long each sensor is recorded.")
    ] = 5.0,
    yes: YesOption = False,
    out: PageOption = None,
    write: Annotated[
        Path | None,
        typer.Option(
            metavar="SCENE.toml", help="Write a copy of the scene here, with the identified keys."
        ),
    ] = None,
    json: TablesOption = None,
    log_level: LogLevelOption = None,
) -> None:
    """Check sensors and drive before a finger is on them, and identify the actuator.

    Without [display.drive] the scene's models are checked, in virtual time. The result of each
    check is ok, warn or fail; the exit status is 1 when a check failed.
    """
    # Imported here: scipy takes long to import, and other commands do without.
    from telepulse.commissioning import bench_check
    from telepulse.commissioning.scene_edit import check_editable, set_keys
    from telepulse.commissioning.tuning import as_toml

    console, findings = plain_console(json=json), bench_check.BenchFindings()

    def check() -> Report:
        configure_logging(log_level)
        check_writable(write)
        path, force_n = find_scene(scene), _force_n(force)
        sections: dict[str, Section] = {}
        if only != "display":
            sections["sensing"] = sensing = load_section(path, "sensing", SensingScene)
        if only != "sensing":
            display = load_section(path, "display", DisplayScene).choose(contactor)
            sections["display"] = display
            if force_n > (limit_n := display.safety.force_limit_n):
                reason = f"{force_n:g} N is above the scene's force_limit, {limit_n:g} N"
                raise SceneError(f"--force: {reason}")
            check_editable(path, write)
            if write is not None and contactor is not None:
                raise SceneError(
                    "--write: not with --contactor; copy the printed keys into its table"
                )
        provenance = collect(path, sections)
        if only != "display":
            bench_check.check_wrist(findings, sensing, path.parent, seconds)
        if only != "sensing":
            if display.drive is not None and not yes:
                print(WARNING.format(force=force))
                if not typer.confirm(BENCH_IS_CLEAR):
                    raise SystemExit(1)
            bench_check.check_display(findings, display, path.parent, force_n, seconds)
            bench_check.check_loop(findings, path, contactor)
        return replace(bench_check.report_bench(path.stem, findings), provenance=provenance)

    publish(check, out, json)
    if findings.changes:
        found = tomlkit.dumps({"display": findings.changes})
        console.print("\nfound, as keys of the scene:\n\n" + found, end="")
        if write is None and contactor is None:
            console.print("\n--write SCENE.toml writes a copy of the scene with them")
    if findings.designs is not None and findings.designs[0].worst.unfit is not None:
        console.print("\ngains for it:\n\n" + as_toml(findings.designs[1].controller))
    if write is not None and findings.changes:
        with one_line_errors(PROGRAM):
            write_whole(write, set_keys(find_scene(scene), findings.changes) + findings.note)
        console.print(f"\nscene: {write}")
    if findings.failed:
        raise SystemExit(1)


def _force_n(text: str) -> float:
    try:
        force_n = parse_quantity(text, "force")
    except ValueError as error:
        raise SceneError(f"--force: {error}") from None
    if not force_n > 0:
        raise SceneError(f"--force: {text!r} must be above 0 N")
    return force_n


def calibrate(
    table: Annotated[
        Path | None,
        typer.Argument(
            metavar="LOADS.csv", help="Loads and readings, a header with units or none."
        ),
    ] = None,
    scene: Annotated[
        str | None,
        typer.Option(help="Read this scene's sensor instead.", autocompletion=scene_names),
    ] = None,
    at: Annotated[
        Literal["wrist", "finger"],
        typer.Option(help="The sensor of that scene: at the wrist or under the finger."),
    ] = "wrist",
    contactor: ContactorOption = None,
    channel: Annotated[
        str | None,
        typer.Option(help="The channel of a sensor that has several; the load is on this one."),
    ] = None,
    loads: Annotated[
        str,
        typer.Option(
            metavar="'0, 0.5, 1 N'",
            help="The reference loads, in the order in which you put them on.",
        ),
    ] = "0, 0.5, 1, 1.5, 2, 2.5, 2, 1.5, 1, 0.5, 0 N",
    load_unit: Annotated[
        LoadUnit | None,
        typer.Option(
            help="Unit of the loads in the file; g and kg are weights. Default: the header's, or N."
        ),
    ] = None,
    reading_unit: Annotated[
        ReadingUnit | None,
        typer.Option(help="Unit of the readings in the file. Default: the header's, or mV."),
    ] = None,
    out: PageOption = None,
    json: TablesOption = None,
) -> None:
    """Fit a sensor's straight line from reference loads, with residuals and R².

    The readings come from a file, or from a sensor under loads that you put on one by one.
    """
    found: list[str] = []

    def ask_for(load_n: float) -> None:
        typer.prompt(f"Put {load_n:g} N on, then press Enter", default="", show_default=False)

    def fit() -> Report:
        if scene is not None:
            path, loads_n = find_scene(scene), parse_loads(loads)
            name, taken = scene, _measure(path, at, contactor, loads_n, ask_for, channel)
        elif table is not None:
            name, taken = table.stem, read_loads(table, load_unit, reading_unit)
        else:
            raise SceneError("nothing to calibrate: give a file of loads, or --scene")
        line = fit_line(taken.load_n, taken.reading)
        found.append(calibration_keys(taken, line))
        return report_calibration(name, taken, line)

    publish(fit, out, json)
    plain_console(json=json).print("\nfor the sensor's table in a scene:\n\n" + found[0])


def _measure(
    path: Path,
    at: str,
    contactor: str | None,
    loads_n: list[float],
    ask: Callable[[float], None],
    channel: str | None,
) -> LoadReadings:
    """Return the readings of a scene's sensor at the wrist or under the finger."""
    opened = partial(open_sensor, folder=path.parent)
    if at == "wrist":
        sensing = load_section(path, "sensing", SensingScene)
        if sensing.sensor is None:
            kind = sensing.source.kind
            raise SceneError(f'{path}: [sensing] source: kind "{kind}" is not a live sensor')
        return measure_loads(sensing.sensor, opened, loads_n, ask, channel)
    display = load_section(path, "display", DisplayScene).choose(contactor)
    film, table = display.feedback, display.drive
    if film is None or table is None:
        raise SceneError(f"{path}: [display.feedback] is missing: describe the film's sensor there")
    if not isinstance(film, DriveFilmScene):
        return measure_loads(film, opened, loads_n, ask, channel)
    # It is not started: only its board's film is read.
    force_limit_n = display.safety.force_limit_n
    drive = build_display_drive(table, display.actuator, display.layer.layer(), force_limit_n)

    def open_raw(raw: DriveFilmScene) -> Sensor:
        return open_film(raw, drive, display.safety.overforce_n, path.parent)

    return measure_loads(film, open_raw, loads_n, ask, channel)


def tune(
    scene: SceneArgument = DEFAULT_SCENE,
    contactor: ContactorOption = None,
    json: TablesOption = None,
) -> None:
    """Print the margins of a scene's force loop, and those of proposed gains.

    Exit status 2 when the scene's own loop is not stable: a display refuses to run it.
    """
    # Imported here: scipy takes long to import, and other commands do without.
    from telepulse.commissioning.tuning import as_toml, design, judge, report_design

    console = plain_console(json=json)
    with one_line_errors(PROGRAM):
        check_writable(json)
        loaded = load_scene(find_scene(scene))
        display = loaded.display.choose(contactor)
        present, proposed = judge(display, display.controller), design(display)
        report = report_design(loaded.path.stem, present, proposed)
        if json is not None:
            write_json(report, json)
        print_tables(report, console)
        console.print(as_toml(proposed.controller), markup=False)
        if present.worst.unfit is not None:
            reason = f"the force loop {present.worst.unfit}: use the proposed gains above"
            raise SceneError(f"{loaded.path}: [display] controller: {reason}")
