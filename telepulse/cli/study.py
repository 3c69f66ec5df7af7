"""`telepulse study`: compute the studies of a person's own data."""

import io
import json as jsons
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import rich.box
import typer
from rich.table import Table

from display_node.verdict import note_lines
from protocol.cli_options import one_line_errors, plain_console
from protocol.errors import OutputError
from protocol.host.output import check_writable, configure_logging, write_whole
from protocol.tactile import JND
from telepulse.cli.options import PROGRAM, SeedOption, TablesOption
from telepulse.cli.progress import SimulationProgress
from telepulse.scene import load_scene, scene_provenance
from telepulse.simulation.record_study import (
    LEARNING_S,
    LEAST_S,
    PLAYOUTS,
    RecordStudy,
    study_record,
)

if TYPE_CHECKING:
    from matplotlib.figure import Figure

# Columns that the wider table takes.
WIDEST = 80


def record(
    file: Annotated[
        Path, typer.Argument(metavar="FILE", help="A recorded pulse that a sensing node plays.")
    ],
    link: Annotated[
        str,
        typer.Option(
            metavar="'delay=40ms,jitter=10ms,loss=1%'",
            help="The link between the nodes; the keys are in docs/scenes.md.",
        ),
    ],
    channel: Annotated[
        str | None,
        typer.Option(
            metavar="NAME",
            help="Name or number of the signal. Default: the one with the shape of a pulse.",
        ),
    ] = None,
    rate: Annotated[
        str | None,
        typer.Option(metavar="'500 Hz'", help="Rate to take in place of the file's."),
    ] = None,
    preload: Annotated[
        str | None,
        typer.Option(metavar="'0.3 N'", help="Added force, so that the pulse stays above 0 N."),
    ] = None,
    seconds: Annotated[
        float,
        typer.Option(
            metavar="SECONDS", min=LEAST_S, max=3600.0, help="Length to use, from the beginning."
        ),
    ] = 60.0,
    seed: SeedOption = 1,
    plot: Annotated[
        Path | None, typer.Option(metavar="FILE.svg", help="Write a plot of both tables here.")
    ] = None,
    json: TablesOption = None,
) -> None:
    """State how well your pulse is predicted over your link, and what to buffer.

    Predicts the recording 20 to 200 ms ahead, and plays it over the link three times in virtual
    time: buffered alone, with the perceived delay E that a display chooses, and at E = 0. The
    predictor learns from the first 15 s, which are not scored.

        telepulse study record pulse.csv --link 'delay=40ms,jitter=10ms,loss=1%' --plot pulse.svg
    """
    console = plain_console(json=json)
    with one_line_errors(PROGRAM):
        configure_logging()
        check_writable(json)
        check_writable(plot)
        figure = None if plot is None else _empty_figure(plot)
        scene = load_scene(source=file, channel=channel, rate=rate, preload=preload, link=link)
        provenance = scene_provenance(scene, {"link": seed})
        with SimulationProgress(len(PLAYOUTS) * seconds) as progress:
            study = study_record(scene, seconds, seed, progress.add)
        title = f"{file.name} over {link or 'a link without delay'}"
        if plot is not None and figure is not None:
            _draw(study, figure)
            # As it is: "$" begins no formula.
            figure.suptitle(title, parse_math=False)
            written = io.StringIO()
            figure.savefig(written, format="svg")
            write_whole(plot, written.getvalue())
        if json is not None:
            origin = {"link": link, "provenance": provenance.to_dict()}
            write_whole(json, jsons.dumps(study.to_dict() | origin, indent=2) + "\n")
    console.print(
        f"{title}: {study.seconds:g} s, of which the first {LEARNING_S:g} s to learn; the usual"
        f" beat is {1e3 * study.height_n:.0f} mN high"
    )
    for line in note_lines(study.notes):
        console.print(line, markup=False)
    for table in _tables(study):
        # Numbers are never cut, however narrow the terminal is.
        console.print(table, width=max(console.width, WIDEST), crop=False)
    console.print(study.advice)


def _tables(study: RecordStudy) -> Iterator[Table]:
    """Yield the table of the predictions, and that of the playouts."""

    def error(force_n: float | None) -> str:
        if force_n is None:
            return "–"
        return f"{1e3 * force_n:.1f} mN, {100 * force_n / study.height_n:.1f} %"

    title = "RMS error ahead of the newest sample, and in % of a beat's height"
    ahead = _table(title, "ahead", "predicted", "newest sample held")
    for each in study.ahead:
        ahead.add_row(f"{each.ahead_ms} ms", error(each.predicted_n), error(each.held_n))
    yield ahead
    title = (
        "Felt at the finger: force RMSE, time in which a finger notices the aligned error,\n"
        "samples late and lost"
    )
    played = _table(title, "", "delay", "in phase", "aligned", "noticed", "late", "lost")
    for playout in study.playouts:
        delay = "–" if playout.delay_ms is None else f"{playout.delay_ms:z.1f} ms"
        aligned_n = playout.aligned_n
        aligned = None if aligned_n is None else aligned_n / study.height_n
        shares = (
            "–" if each is None else f"{100 * each:.1f} %"
            for each in (aligned, playout.noticed, playout.late, playout.lost)
        )
        played.add_row(playout.name, delay, error(playout.in_phase_n), *shares)
    yield played


def _table(title: str, first: str, *columns: str) -> Table:
    table = Table(title=title, title_justify="left", box=rich.box.SIMPLE_HEAD)
    table.add_column(first, no_wrap=True)
    for column in columns:
        table.add_column(column, justify="right", no_wrap=True)
    return table


def _empty_figure(path: Path) -> "Figure":
    """Return a figure for a plot. Raises OutputError where none can be drawn."""
    if path.suffix != ".svg":
        raise OutputError(f"{path}: a plot is written as SVG; give a name that ends in .svg")
    try:
        from matplotlib.figure import Figure
    except ImportError as error:
        raise OutputError(
            f"--plot needs matplotlib, which cannot be loaded ({error});"
            " pip install 'telepulse[report]'"
        ) from None
    return Figure(figsize=(9, 4), layout="constrained")


def _draw(study: RecordStudy, figure: "Figure") -> None:
    """Draw both tables, in % of the beat's height."""
    left, right = figure.subplots(1, 2, sharey=True, width_ratios=(3, 2))
    scale = 100 / study.height_n
    times_ms = [each.ahead_ms for each in study.ahead]
    for label, errors_n in (
        ("predicted", [each.predicted_n for each in study.ahead]),
        ("newest sample held", [each.held_n for each in study.ahead]),
    ):
        left.plot(times_ms, [scale * each for each in errors_n], "o-", label=label)
    names = [each.name.replace(", ", ",\n") for each in study.playouts]
    for shift, label in ((-0.2, "in phase"), (0.2, "aligned")):
        key = "in_phase_n" if label == "in phase" else "aligned_n"
        heights = [scale * (getattr(each, key) or 0.0) for each in study.playouts]
        right.bar([place + shift for place in range(len(names))], heights, 0.4, label=label)
    right.set_xticks(range(len(names)), names, fontsize="small")
    for axes in (left, right):
        axes.axhline(100 * JND, color="0.4", ls=":", lw=1)
        axes.legend()
    left.set_title("Prediction ahead of the newest sample")
    right.set_title("Felt at the finger")
    left.set(xlabel="ahead of the newest sample (ms)", ylabel="RMS error (% of a beat's height)")
    right.set_xlabel("dotted: what a finger notices")


app = typer.Typer(no_args_is_help=True, help="Studies of the system by computation.")
app.command()(record)


@app.callback()
def main() -> None:
    """Keep the name of the one command, which typer would leave out."""
