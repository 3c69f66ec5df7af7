"""Command line of telepulse: what runs both nodes."""

import threading
from dataclasses import replace
from pathlib import Path
from typing import Annotated

import typer

from display_node.fault_advice import end_at_faults
from protocol.cli_options import (
    DurationOption,
    JsonOption,
    StopAfterOption,
    one_line_errors,
    plain_console,
    sum_up,
)
from protocol.host.memory import freeze_objects
from protocol.host.process import allow_connections, stop_on_signals
from protocol.host.result_files import check_writable
from protocol.host.standard_output import unblocked_output
from protocol.security.protection import (
    AllowOption,
    InsecureOption,
    KeyOption,
    PeerOption,
    client_keys,
    server_keys,
)
from telepulse.cli.bench import bench
from telepulse.cli.calibrate import calibrate
from telepulse.cli.demo import run_demo
from telepulse.cli.discover import discover
from telepulse.cli.emulate import app as emulate_app
from telepulse.cli.experiment import app as experiment_app
from telepulse.cli.keys import app as keys_app
from telepulse.cli.lsl import lsl
from telepulse.cli.recordings import export, record, replay, report
from telepulse.cli.relay import relay
from telepulse.cli.report_options import FolderOption, TablesOption, publish
from telepulse.cli.study import app as study_app
from telepulse.cli.view import view
from telepulse.netem.link_proxy import LinkProxy
from telepulse.reports.document import print_tables, write_json
from telepulse.scene import DEFAULT_SCENE, find_scene, load_scene, scene_provenance
from telepulse.simulation.link_model import LinkScene, parse_link
from telepulse.simulation.virtual_time import simulate

PROGRAM = "telepulse"
app = typer.Typer(
    add_completion=False,
    rich_markup_mode="markdown",
    no_args_is_help=True,
    help="A pulse sensed in one place, felt in another: demo, simulation and link emulation.",
)
app.add_typer(study_app, name="study")
app.add_typer(emulate_app, name="emulate")
app.add_typer(experiment_app, name="experiment")
app.add_typer(keys_app, name="keys")
app.command()(unblocked_output()(bench))
app.command()(calibrate)
app.command()(unblocked_output()(relay))
app.command()(discover)
app.command()(unblocked_output()(record))
app.command()(unblocked_output()(replay))
app.command()(export)
app.command()(report)
app.command()(unblocked_output()(view))
app.command()(unblocked_output()(lsl))

SceneArgument = Annotated[
    str, typer.Argument(help="A scene file, or the name of one that comes with telepulse.")
]
LinkOption = Annotated[
    str | None,
    typer.Option(
        metavar="'delay=40ms,jitter=10ms,loss=1%'",
        help="What the link between the nodes does; overrides the scene's [link]. Its keys, such"
        " as burst_loss, rate, cut.from and transport, are in docs/scenes.md.",
    ),
]


@app.command()
@unblocked_output()
def demo(
    scene: SceneArgument = DEFAULT_SCENE,
    seconds: DurationOption = 15.0,
    link: LinkOption = None,
    json: JsonOption = None,
    ui: Annotated[
        bool, typer.Option(help="Show the live state: a panel, or a line a second.")
    ] = True,
    page: Annotated[
        bool | None,
        typer.Option(
            "--page/--no-page",
            help="Serve the live page for a browser, whose address is the first line; as --ui"
            " unless given.",
            show_default=False,
        ),
    ] = None,
) -> None:
    """Run both nodes on this machine over TCP, watch them live, and sum up.

    A sensing node and a display node start as two processes. With --link, a third stands
    between them and delays, jitters and loses frames. At the end, every sample sent is
    accounted for: sent = played + late + lost.

    Exit status: 0 at the end of the pulse, 2 when something given cannot be used, 3 when the
    display latched a fault; the reason is a line on stderr.
    """
    console = plain_console()
    with one_line_errors(PROGRAM):
        check_writable(json)
        path = find_scene(scene)
        loaded = load_scene(path)
        if link:
            loaded = replace(loaded, link=parse_link(link))
        provenance = scene_provenance(loaded)
        summary = run_demo(path, seconds, parse_link(link) if link else None, ui, page, console)
    sum_up(PROGRAM, summary, f"demo of {path.stem}, {seconds:g} s", console, json, provenance)
    end_at_faults(PROGRAM, summary.faults)


@app.command(name="simulate")
def simulate_command(
    scene: SceneArgument = DEFAULT_SCENE,
    seconds: DurationOption = 60.0,
    seed: Annotated[int, typer.Option(min=0, help="Seed of the link's chances.")] = 1,
    link: LinkOption = None,
    json: JsonOption = None,
) -> None:
    """Run a scene in virtual time: the nodes' own modules, no sockets, no waiting.

    The same scene and seed give the same figures, many times faster than real time. Exit status 3:
    the display latched a fault; it is named on stderr.
    """
    with one_line_errors(PROGRAM):
        check_writable(json)
        loaded = load_scene(find_scene(scene))
        if link:
            loaded = replace(loaded, link=parse_link(link))
        provenance = scene_provenance(loaded, {"link": seed})
        summary = simulate(loaded, seconds, seed)
    title = f"simulation of {loaded.path.stem}, {seconds:g} s"
    sum_up(PROGRAM, summary, title, plain_console(), json, provenance)
    end_at_faults(PROGRAM, summary.faults)


@app.command()
def paper(out: FolderOption = Path("out/paper"), json: TablesOption = None) -> None:
    """Compute the paper's figures and numbers again: its, ours, and why they differ.

    Prints the tables and writes a page with all plots, in seconds.
    """
    # The report brings the import times of scipy's signals; other commands do without.
    from telepulse.reports.paper.report import build_report

    publish(build_report, out, json)


@app.command()
def tune(
    scene: SceneArgument = DEFAULT_SCENE,
    json: TablesOption = None,
) -> None:
    """Print the margins of a scene's force loop, and gains by design with theirs.

    Exit status 2 when the scene's own loop is not stable: no node would run it.
    """
    # The design brings scipy's import times; other commands do without.
    from telepulse.commissioning.tuning import as_toml, design, judge, refuse, report_design

    console = plain_console()
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


@app.command(name="link")
@unblocked_output()
def link_command(
    connect: Annotated[str, typer.Option(help="Address of the sensing node.")],
    bind: Annotated[str, typer.Option(help="Address for displays to connect to.")],
    link: LinkOption = None,
    seconds: StopAfterOption = None,
    seed: Annotated[int, typer.Option(min=0, help="Seed of the link's chances.")] = 1,
    key: KeyOption = None,
    peer: PeerOption = None,
    allow: AllowOption = None,
    insecure: InsecureOption = False,
) -> None:
    """Stand between two nodes and make the link between them worse.

    Delays, jitters and loses data frames on their way to the displays; control messages are
    delayed both ways and never lost.
    """
    with one_line_errors(PROGRAM):
        allow_connections()
        # Without --peer the sensing node is on this machine, and has no keys.
        upstream = client_keys([connect], key if peer else None, peer, insecure)
        downstream = server_keys(bind, key, allow, insecure)
        model = parse_link(link) if link else LinkScene()
        between = LinkProxy(model, connect, bind, seed, upstream, downstream)
    stop_on_signals(between.stop)
    if seconds is not None:
        timer = threading.Timer(seconds, between.stop)
        timer.daemon = True
        timer.start()
    freeze_objects()
    between.run()


def main() -> None:
    """Entry point of `telepulse`."""
    app(prog_name=PROGRAM)
