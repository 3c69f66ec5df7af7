"""A run as arrays: the force at the wrist, the target force at the finger, and the felt force."""

import io
import logging
import math
from base64 import b64encode
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from display_node.scoring.beats import Beat, BeatAnalysis
from display_node.scoring.error_sums import rms
from display_node.scoring.tracking_error import Floats, compared_forces_n, interpolate
from protocol.config.arguments import number
from protocol.config.quantities import count_text, shown
from protocol.errors import ArgumentError, OutputError, SourceError
from protocol.summary.fields import RmsErrors, Summary
from protocol.wire.messages import ChannelSamples
from telepulse.columns import Ints, SessionColumns, data_frame, join_ticks

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

logger = logging.getLogger(__name__)

Mask = NDArray[np.bool_]
Force = Literal["wrist_n", "target_n", "felt_n"]
# Characters of a mark's text that a plot shows.
MARK_SHOWN = 30
LABELS = AT_THE_WRIST, AT_THE_FINGER = "wrist, scaled to the same strain", "felt at the finger"
# Part of a run that a notebook shows, around its middle; part of an averaged beat before its onset.
NOTEBOOK_S, BEFORE_ONSET_S = 10.0, 0.1
# Samples a second of a pulse in which beats are found.
SLOWEST_HZ, FASTEST_HZ = 20, 100_000
# Times in ns are whole numbers of 64 bits.
LATEST_S = 9e9
# Ticks that are further apart belong to two parts, of which a run has one.
LONGEST_GAP_NS: Final = 60_000_000_000
# Rows without a tick that a run may have for each tick, and besides.
GAP_ROWS_A_TICK, MOST_GAP_ROWS = 10, 1_000_000


@dataclass(frozen=True, slots=True, eq=False)
class ContactorRun:
    """Forces of one contactor over a run. The arrays have the shape (rows,).

    Attributes
    ----------
    name : str
        Name of the contactor.
    wrist_n : ndarray of float
        Force at the wrist at the time of the tick, in N; NaN where no sample is known.
    target_n : ndarray of float
        Target force at the finger, in N.
    felt_n : ndarray of float
        Force that was felt at the finger, in N; NaN where it is unknown.
    force_ratio : float
        Force at the finger per force at the wrist that makes both strains equal.
    strain_per_newton : float
        Strain under the finger per newton (Dargahi, Xie and Ji 2008).
    film_age_s : float
        Age of `felt_n` at its tick, in s: latency of a real film.
    """

    name: str
    wrist_n: Floats
    target_n: Floats
    felt_n: Floats
    force_ratio: float
    strain_per_newton: float
    film_age_s: float = 0.0

    @property
    def strain(self) -> Floats:
        """Strain under the finger."""
        return self.strain_per_newton * self.felt_n

    @property
    def wrist_strain(self) -> Floats:
        """Strain at the wrist at the time of the tick."""
        return self.strain_per_newton * self.force_ratio * self.wrist_n


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Run:
    """A run of a scene, simulated or recorded. The arrays have the shape (rows,).

    There are `rate_hz` rows a second, one for each tick of the display. A tick that the display
    missed, or that a recording lacks, is a row as well: of NaN, neither `played` nor `predicted`.

    `wrist_n`, `target_n`, `felt_n`, `strain` and `wrist_strain` are those of the first contactor.

    Attributes
    ----------
    name : str
        Name of the scene, of the `source` that was simulated, or of the recording's file.
    t_s : ndarray of float
        Time of each row since the first one, in s, in equal steps.
    delay_s : ndarray of float
        Perceived delay: how much earlier the played instant of the pulse was at the wrist, in s;
        NaN where none was played.
    played : ndarray of bool
        True where a pulse was felt at full strength: `full` of a tick. The share
        `summary.availability.played` has ramps and fades as well.
    predicted : ndarray of bool
        True where a prediction was felt, since the sample had not arrived.
    contactors : dict of str to ContactorRun
        Each contactor, by name, in the display's order.
    summary : Summary
        Figures as the nodes print them. Those of a simulated run are of the same ticks as the
        arrays. Those of a recording are the display's last recorded ones: of its whole run since it
        started, `summary.availability.seconds`, while the arrays have the recorded ticks alone.
    about : dict of str to str
        What a person stated about a recording (`--about`), by key; empty for a simulated run.
    marks : list of (float, str)
        Time in s since the first tick, and text, of each mark of a recording; empty for a simulated
        run.
    """

    name: str
    t_s: Floats
    delay_s: Floats
    played: Mask
    predicted: Mask
    contactors: dict[str, ContactorRun]
    summary: Summary
    about: dict[str, str] = field(default_factory=dict)
    marks: list[tuple[float, str]] = field(default_factory=list)

    def __repr__(self) -> str:
        """Return name, length and contactors; the arrays would fill a screen."""
        seconds = self.t_s[-1] if len(self.t_s) else 0.0
        contactors = ", ".join(filter(None, self.contactors)) or "one"
        return (
            f"Run({self.name!r}, {seconds:.1f} s, {count_text(len(self.t_s), 'tick')} at"
            f" {self.rate_hz:g} Hz, contactors: {contactors})"
        )

    @property
    def rate_hz(self) -> float:
        """Rows a second: the rate of the display's ticks. NaN for a run of one tick."""
        return float(1 / self.t_s[1]) if len(self.t_s) > 1 else math.nan

    @property
    def first(self) -> ContactorRun:
        """The first contactor."""
        return next(iter(self.contactors.values()))

    @property
    def wrist_n(self) -> Floats:
        """Force at the wrist at the time of the tick, in N."""
        return self.first.wrist_n

    @property
    def target_n(self) -> Floats:
        """Target force at the finger, in N."""
        return self.first.target_n

    @property
    def felt_n(self) -> Floats:
        """Force that was felt at the finger, in N."""
        return self.first.felt_n

    @property
    def strain(self) -> Floats:
        """Strain under the finger."""
        return self.first.strain

    @property
    def wrist_strain(self) -> Floats:
        """Strain at the wrist at the time of the tick."""
        return self.first.wrist_strain

    @property
    def force_rmse_n(self) -> RmsErrors:
        """RMSE of the felt force over the arrays, in N: `aligned` and `in_phase`.

        As `summary.force_rmse_n`, but from the ticks of the arrays alone: those at full strength
        for which the force at the wrist is known. None where there is no such tick.
        """
        now_ns, instant_ns = 1e9 * self.t_s, 1e9 * (self.t_s - self.delay_s)
        age_ns, pulse_n = 1e9 * self.first.film_age_s, self.first.force_ratio * self.wrist_n
        compared_n = compared_forces_n(now_ns, instant_ns, now_ns, pulse_n, age_ns)
        return RmsErrors(*(rms((self.felt_n - n)[self.played]) for n in compared_n))

    def beats(self, of: Force = "wrist_n", contactor: str | None = None) -> list[Beat]:
        """Return the beats of a force, as `find_beats` does; their times are since the first row.

        Parameters
        ----------
        of : "wrist_n", "target_n" or "felt_n"
            The force, by the name of its array.
        contactor : str, optional
            Name of the contactor; by default the first one.

        Raises
        ------
        ArgumentError
            If there is no such force or contactor.
        """
        if of not in (forces := get_args(Force)):
            raise ArgumentError(f"of: must be one of {', '.join(forces)}, got {shown(of)}")
        return find_beats(getattr(self._contactor(contactor), of), self.rate_hz)

    def _contactor(self, name: str | None) -> ContactorRun:
        """Return a contactor, by default the first one. Raises ArgumentError."""
        if name is None:
            return self.first
        if name not in self.contactors:
            known = ", ".join(map(repr, self.contactors))
            raise ArgumentError(f"contactor: must be one of {known}, got {shown(name)}")
        return self.contactors[name]

    def columns(self) -> dict[str, NDArray[Any]]:
        """Return all arrays by name; those of further contactors begin with their names."""
        found: dict[str, NDArray[Any]] = {
            key: getattr(self, key) for key in ("t_s", "delay_s", "played", "predicted")
        }
        for contactor in self.contactors.values():
            of = "" if contactor is self.first else f"{contactor.name} "
            for key in ("wrist_n", "target_n", "felt_n", "strain", "wrist_strain"):
                found[of + key] = getattr(contactor, key)
        return found

    def to_dataframe(self) -> "pd.DataFrame":
        """Return the columns as a pandas DataFrame.

        Raises
        ------
        OutputError
            If pandas is not installed.
        """
        return data_frame(self.columns())

    def plot(self, begin_s: float = 0.0, end_s: float = np.inf) -> "NDArray[np.object_]":
        """Draw each contactor's forces, what was predicted, the marks, and below them the delay.

        The figure is pyplot's current one: a notebook shows it, `matplotlib.pyplot.show` opens it.

        Parameters
        ----------
        begin_s, end_s
            Part of the run to draw, in s since its first row.

        Returns
        -------
        ndarray of matplotlib.axes.Axes
            The axes from above, shape (contactors + 1,).

        Raises
        ------
        OutputError
            If matplotlib is not installed.
        """
        return self._draw(_pyplot("plot").figure(layout="constrained"), begin_s, end_s)

    def _draw(self, figure: "Figure", begin_s: float, end_s: float) -> "NDArray[np.object_]":
        """Draw a part of the run into an empty figure, and return the axes."""
        shown = (self.t_s >= begin_s) & (self.t_s <= end_s)
        t_s, predicted = self.t_s[shown], self.predicted[shown]
        rows = len(self.contactors) + 1
        figure.set_size_inches(9, 2 * rows - 0.5)
        grid: NDArray[np.object_] = figure.subplots(rows, sharex=True)
        *forces, below = grid
        for axes, contactor in zip(forces, self.contactors.values(), strict=True):
            wrist_n = contactor.force_ratio * contactor.wrist_n[shown]
            felt_n = contactor.felt_n[shown]
            axes.plot(t_s, wrist_n, label=AT_THE_WRIST, color="C0")
            axes.plot(t_s, felt_n, label=AT_THE_FINGER, color="C1")
            only = np.where(predicted, felt_n, np.nan)
            axes.plot(t_s, only, label="of it predicted", color="C3", lw=2.5, alpha=0.5)
            axes.set(ylabel="force, N", title=contactor.name)
        below.plot(t_s, 1e3 * self.delay_s[shown], color="C2")
        for at_s, text in self.marks:
            if begin_s <= at_s <= end_s:
                for axes in grid:
                    axes.axvline(at_s, color="0.4", ls=":", lw=1)
                # As it is: "$" begins no formula.
                forces[0].annotate(
                    text[:MARK_SHOWN],
                    (at_s, 1),
                    xycoords=("data", "axes fraction"),
                    rotation="vertical",
                    ha="right",
                    va="top",
                    fontsize="x-small",
                    parse_math=False,
                )
        below.set(xlabel=f"{self.name}: time, s", ylabel="perceived delay, ms")
        lines, labels = forces[0].get_legend_handles_labels()
        figure.legend(lines, labels, loc="outside upper center", ncols=3, fontsize="small")
        return grid

    def plot_delay(self, ax: "Axes | None" = None) -> "Axes":
        """Draw the perceived delay E over time; the line is interrupted where no pulse was played.

        Parameters
        ----------
        ax : matplotlib.axes.Axes, optional
            Axes to draw into; by default those of a new figure of pyplot.

        Returns
        -------
        matplotlib.axes.Axes

        Raises
        ------
        OutputError
            If matplotlib is not installed.
        """
        ax = _axes("plot_delay", ax)
        ax.plot(self.t_s, 1e3 * self.delay_s, color="C2")
        ax.set(xlabel="time, s", ylabel="perceived delay E, ms")
        ax.set_title(self.name, parse_math=False)
        return ax

    def plot_beat(self, ax: "Axes | None" = None, contactor: str | None = None) -> "Axes":
        """Draw the ensemble-averaged beat at the wrist and at the finger.

        The beats are aligned at their onsets at the wrist, so that the felt one is later by the
        perceived delay. Lines are means, bands one standard deviation to either side. Averaged are
        the good beats that were felt whole at full strength.

        Parameters
        ----------
        ax : matplotlib.axes.Axes, optional
            Axes to draw into; by default those of a new figure of pyplot.
        contactor : str, optional
            Name of the contactor; by default the first one.

        Returns
        -------
        matplotlib.axes.Axes

        Raises
        ------
        ArgumentError
            If there is no such contactor.
        OutputError
            If there is no beat to average, or matplotlib is not installed.
        """
        played = self._contactor(contactor)
        good = [beat for beat in self.beats(contactor=contactor) if beat.good]
        length_s = float(np.median([beat.interval_s for beat in good])) if good else 0.0
        after_s = np.arange(-BEFORE_ONSET_S, length_s, 1 / self.rate_hz)
        onsets_ns = np.array([beat.onset_ns for beat in good]).reshape(-1, 1)
        forces_n = played.force_ratio * played.wrist_n, np.where(self.played, played.felt_n, np.nan)
        at_ns = onsets_ns + 1e9 * after_s
        beats_n = np.stack([_bridged(at_ns, 1e9 * self.t_s, force_n) for force_n in forces_n])
        beats_n = beats_n[:, ~np.isnan(beats_n).any(axis=(0, 2))]
        if not (count := beats_n.shape[1]):
            raise OutputError(f"{self.name}: no good beat was felt whole at full strength")
        ax = _axes("plot_beat", ax)
        for each_n, label, color in zip(beats_n, LABELS, ("C0", "C1"), strict=True):
            mean_n, deviation_n = each_n.mean(axis=0), each_n.std(axis=0)
            ax.plot(after_s, mean_n, label=label, color=color)
            low_n, high_n = mean_n - deviation_n, mean_n + deviation_n
            ax.fill_between(after_s, low_n, high_n, color=color, alpha=0.25, lw=0)
        ax.set(xlabel="time since the onset at the wrist, s", ylabel="force, N")
        ax.set_title(f"{self.name}: mean of {count_text(count, 'beat')}", parse_math=False)
        ax.legend()
        return ax

    def _repr_html_(self) -> str:
        """Return the verdict on the run and a plot of some seconds, which a notebook shows."""
        from display_node.verdict import verdict

        lines = [f"<b>{escape(repr(self))}</b>"]
        if self.summary == Summary():
            lines.append("The recording holds no summary of the display.")
        else:
            lines += map(escape, verdict(self.summary).lines)
        begin_s = max(0.0, (float(self.t_s[-1]) - NOTEBOOK_S) / 2)
        try:
            figure = _pyplot("the plot of a run").Figure(layout="constrained")
        except OutputError as error:
            lines.append(escape(str(error)))
        else:
            self._draw(figure, begin_s, begin_s + NOTEBOOK_S)
            drawn = io.BytesIO()
            figure.savefig(drawn, format="png")
            data = b64encode(drawn.getvalue()).decode()
            described = f"forces and perceived delay over {NOTEBOOK_S:g} s from {begin_s:.1f} s on"
            lines.append(f'<img alt="{described}" src="data:image/png;base64,{data}">')
        return "<br>\n".join(lines)


def _pyplot(what: str) -> Any:
    """Return matplotlib's pyplot. Raises OutputError without it."""
    try:
        from matplotlib import pyplot
    except ImportError as error:
        raise OutputError(
            f"{what} needs matplotlib, which cannot be loaded ({error});"
            " pip install 'telepulse[report]'"
        ) from None
    return pyplot


def _axes(what: str, ax: "Axes | None") -> "Axes":
    """Return the axes that were given, or those of a new figure. Raises OutputError."""
    return _pyplot(what).subplots(layout="constrained")[1] if ax is None else ax


def _bridged(at_ns: Floats, t_ns: Floats, force_n: Floats) -> Floats:
    """Return a force at some times; missing rows are bridged as short gaps of a pulse are."""
    known = ~np.isnan(force_n)
    return interpolate(at_ns, t_ns[known], force_n[known])


class TickGrid:
    """Rows of equal time, one for each tick, with gaps where ticks are missing.

    The display keeps its ticks to a grid of its period, so that the least time between two of them
    is the period. Ticks of another start of the display, a long time later or on a clock that has
    begun anew, have no place on it: the longest part is used.

    Raises SourceError where the rows would be far more than the ticks.
    """

    def __init__(self, path: Path, now_ns: Ints) -> None:
        steps_ns = np.diff(now_ns)
        ends = np.flatnonzero((steps_ns <= 0) | (steps_ns > LONGEST_GAP_NS)) + 1
        parts = np.split(np.arange(len(now_ns)), ends)
        #: Places of the part's ticks among all.
        self.used = max(parts, key=len)
        if len(self.used) < len(now_ns):
            logger.warning(
                f"{path}: its ticks are in {len(parts)} parts, more than"
                f" {LONGEST_GAP_NS * 1e-9:g} s apart or of different clocks; the arrays have the"
                f" longest one, {len(self.used)} of {count_text(len(now_ns), 'tick')}"
            )
        used_ns = now_ns[self.used]
        self.begin_ns = int(used_ns[0]) if len(used_ns) else 0
        self.period_ns = int(np.diff(used_ns).min(initial=LONGEST_GAP_NS))
        # No two ticks share a row: they are a period apart or more.
        self._rows = (used_ns - self.begin_ns + self.period_ns // 2) // self.period_ns
        self.length = int(self._rows[-1]) + 1 if len(used_ns) else 0
        missing = self.length - len(used_ns)
        if missing > GAP_ROWS_A_TICK * len(used_ns) + MOST_GAP_ROWS:
            raise SourceError(
                f"{path}: has {count_text(len(used_ns), 'tick')}, of which some are"
                f" {self.period_ns} ns apart, in {self.length * self.period_ns * 1e-9:.0f} s: too"
                " few for arrays of equal steps; export it to csv"
            )

    def place(self, values: NDArray[Any], missing: Any) -> NDArray[Any]:
        """Return the values of all ticks at the rows of the used ones, `missing` in the others."""
        placed = np.full(self.length, missing, values.dtype)
        placed[self._rows] = values[self.used]
        return placed


def build_run(
    path: Path,
    sessions: Sequence[SessionColumns],
    summary: Summary,
    about: Mapping[str, str] = {},
    marks: Sequence[tuple[int, str]] = (),
) -> Run:
    """Return the run of some sessions, with the contactors that play the last one.

    path: of the scene, the source or the recording. about: what was stated about the run. marks:
    Unix time and text of each. Raises SourceError where the ticks cannot be placed on a grid.
    """
    now_ns, unix_ns, sensing_ns, instant_ns, playing, full, predicted = (
        join_ticks(sessions, column)
        for column in (
            *("now_ns", "unix_ns", "sensing_ns", "instant_ns"),
            *("playing", "full", "predicted"),
        )
    )
    grid = TickGrid(path, now_ns)
    delay_s: Floats = np.where(playing, (sensing_ns - instant_ns) * 1e-9, np.nan)
    return Run(
        path.stem,
        np.arange(grid.length, dtype=np.float64) * grid.period_ns * 1e-9,
        grid.place(delay_s, np.nan),
        grid.place(full, False),
        grid.place(predicted, False),
        {
            contactor: _contactor_run(contactor, sessions, grid)
            for contactor in sessions[-1].playing
        },
        summary,
        dict(about),
        sorted(_timed(marks, unix_ns[grid.used], now_ns[grid.used])),
    )


def _timed(
    marks: Sequence[tuple[int, str]], unix_ns: Ints, now_ns: Ints
) -> Iterator[tuple[float, str]]:
    """Yield the marks by the display's clock, in s since the first of some ticks."""
    for mark_ns, text in marks if len(now_ns) else ():
        tick = max(0, int(np.searchsorted(unix_ns, mark_ns, "right")) - 1)
        after_ns = mark_ns - unix_ns[tick]
        yield float(now_ns[tick] + after_ns - now_ns[0]) * 1e-9, text


def _contactor_run(name: str, sessions: Sequence[SessionColumns], grid: TickGrid) -> ContactorRun:
    """Return the forces of a contactor; NaN in sessions that it did not play."""
    wrist_n, forces_n = list[Floats](), list[tuple[Floats, Floats]]()
    for session in sessions:
        ready, at_ns = session.ticks["ready"], session.ticks["sensing_ns"]
        played = session.playing.get(name)
        sensed_n = np.full(len(ready), np.nan)
        if played is not None:
            sensed_n[ready] = interpolate(at_ns[ready], *session.pulse(played.channel))
        wrist_n.append(sensed_n)
        forces_n.append(session.forces_n(name))
    target_n, felt_n = map(np.concatenate, zip(*forces_n, strict=True))
    last = sessions[-1].playing[name]
    return ContactorRun(
        name,
        grid.place(np.concatenate(wrist_n), np.nan),
        grid.place(target_n, np.nan),
        grid.place(felt_n, np.nan),
        last.force_ratio,
        last.strain_per_newton,
        last.film_age_ns * 1e-9,
    )


def find_beats(
    force_n: "Floats | Run", rate_hz: float | None = None, *, t_s: Floats | None = None
) -> list[Beat]:
    """Return the beats of a pulse, as a display finds them.

    Parameters
    ----------
    force_n : ndarray of float, or Run
        Force or pressure, shape (samples,); NaN where it is unknown. Heights have the unit of the
        values. Light falls with each beat: give its negative. Of a `Run`, which states its rate,
        the force at the wrist is searched: `Run.beats` without arguments.
    rate_hz : float, optional
        Samples a second of an array at equal intervals, 20 to 100 000.
    t_s : ndarray of float, optional
        In place of `rate_hz`, the rising times of the samples in s, shape (samples,). Their usual
        interval is that of such a rate.

    Returns
    -------
    list of Beat
        Times in ns: since the first sample, or on the clock of `t_s`. The search begins anew after
        a gap of 0.1 s. The first and the last beat are not complete, and missing.

    Raises
    ------
    ArgumentError
        If an argument is not as above. It is a ValueError as well.

    Examples
    --------
    >>> import numpy as np
    >>> import telepulse
    >>> t_s = np.arange(0, 20, 0.004)
    >>> beats = telepulse.find_beats(np.sin(2 * np.pi * 1.25 * t_s) ** 4, 250)
    >>> print(f"{np.median([beat.interval_s for beat in beats]):.2f} s")
    0.40 s
    """
    if isinstance(force_n, Run):
        if rate_hz is not None or t_s is not None:
            raise ArgumentError("force_n: a Run states its rate; give no rate_hz or t_s with it")
        return force_n.beats()
    forces_n = _numbers("force_n", force_n)
    times_ns, period_ns = _sample_times(len(forces_n), rate_hz, t_s)
    analysis, beats = BeatAnalysis(), list[Beat]()
    # Held for a second after the last sample, so that it is averaged as well.
    held_ns = times_ns[-1:, np.newaxis] + np.arange(0, 1_000_000_000, period_ns) + period_ns
    times_ns = np.concatenate([times_ns, held_ns.ravel()])
    forces_n = np.concatenate([forces_n, np.repeat(forces_n[-1:], held_ns.size)])
    known = np.isfinite(forces_n)
    # Frames of about 0.1 s: levels are those of the last seconds before a frame's end.
    ends = np.arange(0, len(forces_n), math.ceil(1e8 / period_ns))[1:]
    ends = np.union1d(ends, np.flatnonzero(np.diff(known)) + 1)
    ends = np.union1d(ends, np.flatnonzero(np.diff(times_ns) > 1.5 * period_ns) + 1)
    for samples in np.split(np.arange(len(forces_n)), ends):
        if len(samples) and known[samples[0]]:
            frame_ns, frame_n = times_ns[samples].tolist(), forces_n[samples].tolist()
            beats += analysis.observe(ChannelSamples(int(samples[0]), period_ns, frame_ns, frame_n))
    return beats


def _numbers(name: str, values: object) -> Floats:
    """Return an array of numbers of one dimension. Raises ArgumentError."""
    try:
        numbers = np.asarray(values, np.float64)
    except (ValueError, TypeError) as error:
        raise ArgumentError(f"{name}: must be an array of numbers: {error}") from None
    if numbers.ndim != 1:
        raise ArgumentError(f"{name}: must have one dimension, got the shape {numbers.shape}")
    return numbers


def _sample_times(count: int, rate_hz: float | None, t_s: object) -> tuple[Ints, int]:
    """Return the time of each sample and the usual one between two, in ns. Raises ArgumentError."""
    if (rate_hz is None) == (t_s is None):
        raise ArgumentError("rate_hz: give the samples a second, or their times as t_s, not both")
    if t_s is None:
        period_ns = round(1e9 / number("rate_hz", rate_hz, SLOWEST_HZ, FASTEST_HZ))
        return np.arange(count) * period_ns, period_ns
    times_s = _numbers("t_s", t_s)
    if len(times_s) != count:
        raise ArgumentError(f"t_s: must have the {count} values of force_n, got {len(times_s)}")
    steps_s = np.diff(times_s)
    if not (np.abs(times_s) < LATEST_S).all() or not (steps_s > 0).all():
        raise ArgumentError("t_s: must be finite times in s, each later than the one before")
    usual_s = float(np.median(steps_s)) if len(steps_s) else 1 / SLOWEST_HZ
    number("t_s: samples a second", 1 / usual_s, SLOWEST_HZ, FASTEST_HZ)
    return np.rint(times_s * 1e9).astype(np.int64), round(usual_s * 1e9)
