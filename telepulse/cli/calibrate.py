"""`telepulse calibrate`: the line from reference loads to a film's readings."""

from enum import Enum
from pathlib import Path
from typing import Annotated

import typer

from display_node.scene import DisplayScene
from protocol.cli_options import plain_console
from protocol.config.scene import load_section
from protocol.config.scene_file import find_scene
from protocol.errors import SceneError
from pulse_sensors.force_scale import SensorTable
from pulse_sensors.sensor import SensorScene
from sensing_node.scene import SensingScene
from telepulse.cli.options import PageOption, TablesOption, publish
from telepulse.commissioning.calibration import LoadReadings, LoadUnit, ReadingUnit, read_loads
from telepulse.reports.document import Report


class Place(Enum):
    """Which of a scene's sensors is calibrated."""

    WRIST = "wrist"
    FINGER = "finger"


def calibrate(
    table: Annotated[
        Path | None,
        typer.Argument(
            metavar="LOADS.csv", help="Loads and readings, a header with units or none."
        ),
    ] = None,
    scene: Annotated[str | None, typer.Option(help="Read this scene's sensor instead.")] = None,
    at: Annotated[Place, typer.Option(help="Which of its sensors.")] = Place.WRIST,
    loads: Annotated[
        str, typer.Option(metavar="'0, 0.5, 1 N'", help="What will be put on it, in this order.")
    ] = "0, 0.5, 1, 1.5, 2, 2.5, 2, 1.5, 1, 0.5, 0 N",
    load_unit: Annotated[
        LoadUnit | None, typer.Option(help="Of the file; g and kg are weights. Else N.")
    ] = None,
    reading_unit: Annotated[ReadingUnit | None, typer.Option(help="Of the file. Else mV.")] = None,
    out: PageOption = None,
    json: TablesOption = None,
) -> None:
    """Fit the straight line of Fig. 4 from reference loads, with residuals and R².

    From a file, or from a sensor under loads that you put on one by one.
    """
    from telepulse.commissioning.calibration import fit_line, report_calibration, scene_lines

    found: list[str] = []

    def fit() -> Report:
        if scene is not None:
            name, taken = scene, _from_scene(scene, at, loads)
        elif table is not None:
            name, taken = table.stem, read_loads(table, load_unit, reading_unit)
        else:
            raise SceneError("what shall be calibrated? Give a file of loads, or --scene")
        line = fit_line(taken.load_n, taken.reading)
        found.append(scene_lines(taken, line))
        return report_calibration(name, taken, line)

    publish(fit, out, json)
    plain_console(json=json).print("\nfor the sensor's table in a scene:\n\n" + found[0])


def _from_scene(scene: str, at: Place, loads: str) -> LoadReadings:
    from telepulse.commissioning.calibration import parse_loads, take_loads

    path, loads_n = find_scene(scene), parse_loads(loads)

    def ask(load_n: float) -> None:
        typer.prompt(f"Put {load_n:g} N on, then press Enter", default="", show_default=False)

    return take_loads(_sensor(path, at), path.parent, loads_n, ask)


def _sensor(path: Path, at: Place) -> SensorScene:
    if at is Place.FINGER:
        film = load_section(path, "display", DisplayScene).feedback
        if film is None:
            raise SceneError(f"{path}: [display.feedback] is missing: which sensor reads the film?")
        return film
    source = load_section(path, "sensing", SensingScene).source
    if not isinstance(source, SensorTable):
        raise SceneError(f'{path}: [sensing] source: kind "{source.kind}" is not a live sensor')
    return source
