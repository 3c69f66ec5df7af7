"""`telepulse tune`."""

from protocol.cli_options import one_line_errors, plain_console
from protocol.config.scene_file import find_scene
from protocol.host.output import check_writable
from telepulse.cli.options import PROGRAM, SceneArgument, TablesOption
from telepulse.reports.document import print_tables, write_json
from telepulse.scene import DEFAULT_SCENE, load_scene


def tune(scene: SceneArgument = DEFAULT_SCENE, json: TablesOption = None) -> None:
    """Print the margins of a scene's force loop, and gains by design with theirs.

    Exit status 2 when the scene's own loop is not stable: no node would run it.
    """
    # Imported here: scipy takes long to import, and other commands do without.
    from telepulse.commissioning.tuning import as_toml, design, judge, refuse, report_design

    console = plain_console(json=json)
    with one_line_errors(PROGRAM):
        check_writable(json)
        loaded = load_scene(find_scene(scene))
        present, proposed = judge(loaded.display, loaded.display.controller), design(loaded.display)
        report = report_design(loaded.path.stem, present, proposed)
        if json is not None:
            write_json(report, json)
        print_tables(report, console)
        console.print(as_toml(proposed.controller), markup=False)
        refuse(loaded.path, present)
