"""Command line of the soak: `python -m soak`."""

import asyncio
import signal
import tempfile
from pathlib import Path
from typing import Annotated

import typer

from protocol.cli_options import JsonOption, one_line_errors, plain_console
from protocol.config.scene_file import find_scene
from protocol.host.output import check_writable
from soak.bench import play_rounds
from soak.bench_truth import judge_bench
from soak.evidence import heart_rate_per_min, verdict
from soak.leftovers import left_behind, mark
from soak.network import namespaces
from soak.report import print_verdict, write_verdict
from soak.run import Run
from soak.scenario import Scenario
from soak.verdict import judge_none
from telepulse.scene import DEFAULT_SCENE, load_scene
from tests.support.keyring import Keyring

PROGRAM = "soak"
# Nodes end by themselves this long after the soak's time.
OVERTIME_S = 300.0


def soak(
    minutes: Annotated[float, typer.Option(min=0.2, max=10_000, help="How long.")] = 20.0,
    seed: Annotated[int, typer.Option(min=0, help="Seed of the faults and their times.")] = 1,
    scene: Annotated[
        str, typer.Option(help="A scene file, or the name of one that comes with telepulse.")
    ] = DEFAULT_SCENE,
    keys: Annotated[
        bool,
        typer.Option("--keys", help="Protect the nodes by keys; floods and impostors have none."),
    ] = False,
    realtime: Annotated[
        str | None,
        typer.Option(metavar="LIST", help="The nodes' own --realtime, such as fifo=40,slack."),
    ] = None,
    bench: Annotated[
        int,
        typer.Option(
            min=0,
            max=1000,
            metavar="ROUNDS",
            help="Number of faults on an emulated bench at the end, some 15 s each; 0: none.",
        ),
    ] = 6,
    json: JsonOption = None,
) -> None:
    """Run both nodes under random faults, and judge the result.

    A sensing node and its displays run as processes of their own, over links that degrade and are
    cut. Nodes are killed, restarted and stopped, displays join and leave, garbage floods the ports.
    An undisturbed pair runs beside them. At the end a display with an emulated drive is stalled and
    cut off. docs/soak.md lists the checks.

    Exit status: 0 when every check is passed, 1 when one is not, 2 when it cannot run here.
    """
    console = plain_console()
    with one_line_errors(PROGRAM):
        check_writable(json)
        loaded = load_scene(find_scene(scene))
        mark()
        # A soak in the background must also end its nodes on both signals.
        signal.signal(signal.SIGINT, signal.default_int_handler)
        signal.signal(signal.SIGTERM, lambda *_: signal.raise_signal(signal.SIGINT))
        with (
            tempfile.TemporaryDirectory(prefix="telepulse-soak-") as folder,
            namespaces(seed) as network,
        ):
            how = "with" if keys else "without"
            console.print(f"{minutes:g} minutes of faults by seed {seed}, {how} keys")
            ring = None
            if keys:
                ring = Keyring(Path(folder, "keys"))
                # Of the displays, and of the listener beside the sensing node.
                ring.allow("finger", "monitor")
            longest_s = minutes * 60 + OVERTIME_S
            options = ("--realtime", realtime) if realtime else ()
            scenario = Scenario(network, loaded.path, Path(folder), longest_s, ring, options)
            run = Run(scenario, seed, minutes * 60, loaded.display.tick_ns, console.print)
            try:
                asyncio.run(run.play())
            finally:
                scenario.clear()
            checks = verdict(run, loaded.display, heart_rate_per_min(loaded.sensing.source))
            if bench:
                checks += judge_bench(*play_rounds(Path(folder), seed, bench, console.print))
        left = left_behind(run.namespaces, [scenario.calm_address], folder)
        checks.append(judge_none("left behind", left))
    print_verdict(run, checks, console)
    if json is not None:
        with one_line_errors(PROGRAM):
            write_verdict(run, checks, minutes, json)
    raise SystemExit(any(check.ok is False for check in checks))


if __name__ == "__main__":
    typer.run(soak)
