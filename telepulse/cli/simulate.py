"""`telepulse simulate`."""

from dataclasses import replace

from display_node.fault_advice import end_at_faults
from protocol.cli_options import (
    DurationOption,
    JsonOption,
    one_line_errors,
    plain_console,
    sum_up,
)
from protocol.config.scene_file import find_scene
from protocol.host.output import check_writable
from telepulse.cli.options import PROGRAM, LinkOption, SceneArgument, SeedOption
from telepulse.scene import DEFAULT_SCENE, load_scene, scene_provenance
from telepulse.simulation import virtual_time
from telepulse.simulation.link_model import parse_link


def simulate(
    scene: SceneArgument = DEFAULT_SCENE,
    seconds: DurationOption = 60.0,
    seed: SeedOption = 1,
    link: LinkOption = None,
    json: JsonOption = None,
) -> None:
    """Run a scene in virtual time: the nodes' own modules, without sockets and without waiting.

    The same scene and seed give the same figures, many times faster than real time. Exit status 3:
    the display latched a fault; it is named on stderr.
    """
    with one_line_errors(PROGRAM):
        check_writable(json)
        loaded = load_scene(find_scene(scene))
        if link:
            loaded = replace(loaded, link=parse_link(link))
        provenance = scene_provenance(loaded, {"link": seed})
        summary = virtual_time.simulate(loaded, seconds, seed)
    title = f"simulation of {loaded.path.stem}, {seconds:g} s"
    sum_up(PROGRAM, summary, title, plain_console(), json, provenance)
    end_at_faults(PROGRAM, summary.faults)
