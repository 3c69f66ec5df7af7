"""`telepulse bench`: check a bench before a finger is on it."""

from dataclasses import replace
from enum import Enum
from pathlib import Path
from typing import Annotated

import typer

from display_node.scene import DisplayScene
from protocol.cli_options import BENCH_IS_CLEAR, LogLevelOption, one_line_errors, plain_console
from protocol.config.quantities import parse_quantity
from protocol.config.scene import load_section
from protocol.config.scene_file import find_scene
from protocol.errors import SceneError
from protocol.host.output import check_writable, configure_logging
from protocol.provenance import collect
from sensing_node.scene import SensingScene
from telepulse.cli.options import (
    PROGRAM,
    PageOption,
    SceneArgument,
    TablesOption,
    YesOption,
    publish,
)
from telepulse.reports.document import Report
from telepulse.scene import DEFAULT_SCENE

WARNING = (
    "The drive will move and press with up to {force}. Keep fingers away: put a dummy of rubber"
    " in the finger's place."
)


class Side(Enum):
    """The end of the system that is on this machine."""

    SENSING = "sensing"
    DISPLAY = "display"
    BOTH = "both"


def bench(
    scene: SceneArgument = DEFAULT_SCENE,
    only: Annotated[Side, typer.Option(help="The end that is on this machine.")] = Side.BOTH,
    force: Annotated[str, typer.Option(help="Press with no more than this.")] = "0.3 N",
    seconds: Annotated[
        float, typer.Option(min=1, max=3600, help="How long each sensor is recorded.")
    ] = 5.0,
    yes: YesOption = False,
    out: PageOption = None,
    write: Annotated[
        Path | None,
        typer.Option(metavar="SCENE.toml", help="Write the scene here, with the found keys."),
    ] = None,
    json: TablesOption = None,
    log_level: LogLevelOption = None,
) -> None:
    """Check sensors and drive before a finger is on them, and identify the actuator.

    Without [display.drive] the scene's models are checked, in virtual time. Every check ends in
    ok, warn or fail; exit status 1 when one failed.
    """
    # Imported here: scipy takes long to import, and other commands do without.
    from telepulse.commissioning import bench_check
    from telepulse.commissioning.scene_edit import as_toml, check_editable, write_scene
    from telepulse.commissioning.tuning import as_toml as gains_as_toml

    console, findings = plain_console(json=json), bench_check.BenchFindings()

    def check() -> Report:
        configure_logging(log_level)
        check_writable(write)
        path, force_n = find_scene(scene), _force_n(force)
        sensing, display = None, None
        if only is not Side.DISPLAY:
            sensing = load_section(path, "sensing", SensingScene)
        if only is not Side.SENSING:
            display = load_section(path, "display", DisplayScene)
            _within_limits(force_n, display)
            check_editable(path, write)
        sections = {"sensing": sensing, "display": display}
        used = {name: section for name, section in sections.items() if section is not None}
        provenance = collect(path, used)
        if sensing is not None:
            bench_check.check_wrist(findings, sensing, path.parent, seconds)
        if display is not None:
            if display.drive is not None and not yes:
                _ask(force)
            bench_check.check_display(findings, display, path.parent, force_n, seconds)
            bench_check.check_loop(findings, path)
        return replace(bench_check.report_bench(path.stem, findings), provenance=provenance)

    publish(check, out, json)
    if findings.changes:
        console.print("\nfound, as keys of the scene:\n\n" + as_toml(findings.changes))
        if write is None:
            console.print("\n--write SCENE.toml writes a copy of the scene with them")
    if findings.designs is not None and findings.designs[0].worst.unfit is not None:
        console.print("\ngains for it:\n\n" + gains_as_toml(findings.designs[1].controller))
    if write is not None and findings.changes:
        with one_line_errors(PROGRAM):
            write_scene(find_scene(scene), write, findings.changes, findings.note)
        console.print(f"\nscene: {write}")
    if findings.failed:
        raise SystemExit(1)


def _ask(force: str) -> None:
    print(WARNING.format(force=force))
    if not typer.confirm(BENCH_IS_CLEAR):
        raise SystemExit(1)


def _force_n(text: str) -> float:
    try:
        force_n = parse_quantity(text, "force")
    except ValueError as error:
        raise SceneError(f"--force: {error}") from None
    if not force_n > 0:
        raise SceneError(f"--force: {text!r} must be above 0 N")
    return force_n


def _within_limits(force_n: float, display: DisplayScene) -> None:
    limit_n = display.safety.force_limit_n
    if force_n > limit_n:
        raise SceneError(f"--force: {force_n:g} N is above the scene's force_limit, {limit_n:g} N")
