"""A run as arrays: the force at the wrist, the force that was due, and the one that was felt."""

from array import array
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from display_node.scoring.tracking_error import interpolate
from protocol.config.quantities import count_text
from protocol.errors import OutputError
from protocol.summary.tables import AlignedErrors, Summary
from protocol.wire.messages import Frame
from protocol.wire.telemetry import PlaybackStatus

if TYPE_CHECKING:
    import pandas as pd

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Mask = NDArray[np.bool_]
# Characters of a mark's text that a plot shows.
MARK_SHOWN = 30


@dataclass(frozen=True, slots=True, eq=False)
class ContactorRun:
    """Forces of one contactor over a run. The arrays have the shape (ticks,).

    Attributes
    ----------
    name : str
        Name of the contactor.
    wrist_n : ndarray of float
        Force at the wrist at the time of the tick, in N; NaN where no sample is known.
    target_n : ndarray of float
        Force that was due at the finger, in N.
    felt_n : ndarray of float
        Force that was felt at the finger, in N; NaN where it is unknown.
    force_ratio : float
        Force at the finger per force at the wrist that makes both strains equal.
    strain_per_newton : float
        Strain under the finger per newton (Dargahi, Xie and Ji 2008).
    """

    name: str
    wrist_n: Floats
    target_n: Floats
    felt_n: Floats
    force_ratio: float
    strain_per_newton: float

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
    """A run of a scene, simulated or recorded. The arrays have the shape (ticks,).

    `wrist_n`, `target_n`, `felt_n`, `strain` and `wrist_strain` are those of the first contactor.

    Attributes
    ----------
    name : str
        Name of the scene, or of the recording's file.
    t_s : ndarray of float
        Time of each tick since the first one, in s.
    delay_s : ndarray of float
        Perceived delay: how much earlier the played instant of the pulse was at the wrist, in s;
        NaN where none was played.
    played : ndarray of bool
        True where a pulse was felt at full strength.
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
            f"Run({self.name!r}, {seconds:.1f} s, {count_text(len(self.t_s), 'tick')},"
            f" contactors: {contactors})"
        )

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
        """Force that was due at the finger, in N."""
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
    def force_rmse_n(self) -> AlignedErrors:
        """RMSE of the felt force over the arrays, in N: `aligned` and `in_phase`.

        As `summary.force_rmse_n`, but from the ticks of the arrays alone: those at full strength
        for which the force at the wrist is known. None where there is no such tick.
        """
        wrist_n = self.first.force_ratio * self.wrist_n
        then_n = np.interp(self.t_s - self.delay_s, self.t_s, wrist_n)
        return AlignedErrors(*(_rms((self.felt_n - n)[self.played]) for n in (then_n, wrist_n)))

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
        """Return the columns as a pandas DataFrame, one row a tick.

        Raises
        ------
        OutputError
            If pandas is not installed.
        """
        try:
            import pandas as pd
        except ImportError as error:
            raise OutputError(
                f"to_dataframe needs pandas, which cannot be loaded ({error});"
                " pip install 'telepulse[analysis]'"
            ) from None
        return pd.DataFrame(self.columns())

    def plot(self, begin_s: float = 0.0, end_s: float = np.inf) -> "NDArray[np.object_]":
        """Draw each contactor's forces, what was predicted, the marks, and below them the delay.

        The figure is pyplot's current one: a notebook shows it, `matplotlib.pyplot.show` opens it.

        Parameters
        ----------
        begin_s, end_s
            Part of the run to draw, in s since its first tick.

        Returns
        -------
        ndarray of matplotlib.axes.Axes
            The axes from above, shape (contactors + 1,).

        Raises
        ------
        OutputError
            If matplotlib is not installed.
        """
        try:
            from matplotlib import pyplot as plt
        except ImportError as error:
            raise OutputError(
                f"plot needs matplotlib, which cannot be loaded ({error});"
                " pip install 'telepulse[report]'"
            ) from None
        shown = (self.t_s >= begin_s) & (self.t_s <= end_s)
        t_s, predicted = self.t_s[shown], self.predicted[shown]
        rows = len(self.contactors) + 1
        size = (9, 2 * rows - 0.5)
        grid: NDArray[np.object_]
        figure, grid = plt.subplots(rows, sharex=True, figsize=size, layout="constrained")
        *forces, below = grid
        for axes, contactor in zip(forces, self.contactors.values(), strict=True):
            wrist_n = contactor.force_ratio * contactor.wrist_n[shown]
            felt_n = contactor.felt_n[shown]
            axes.plot(t_s, wrist_n, label="wrist, scaled to the same strain", color="C0")
            axes.plot(t_s, felt_n, label="felt at the finger", color="C1")
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


def _rms(error_n: Floats) -> float | None:
    known_n = error_n[~np.isnan(error_n)]
    return float(np.sqrt(np.mean(known_n**2))) if len(known_n) else None


class RunTick(NamedTuple):
    """A tick of a run. Times in ns.

    sensing_now_ns: None where the sensing clock is unknown. instant_ns: the played instant of the
    pulse; None where none was played. played: at full strength.
    """

    now_ns: int
    sensing_now_ns: int | None
    instant_ns: int | None
    played: bool
    predicted: bool


class _Session:
    """Samples and ticks of one session of the sensing node."""

    def __init__(self) -> None:
        self.frames: list[tuple[Ints, Floats]] = []
        self.sensing_ns = array("q")

    def wrist_n(self, channel: int) -> Floats:
        """Return the force of a channel at each tick, NaN where no sample is known."""
        at_ns = np.array(self.sensing_ns, np.int64)
        if not self.frames:
            return np.full(len(at_ns), np.nan)
        t_ns = np.concatenate([t_ns for t_ns, _ in self.frames])
        order = np.argsort(t_ns, kind="stable")
        values = np.concatenate([values for _, values in self.frames])[:, channel]
        return interpolate(at_ns, t_ns[order], values[order])


class RunBuilder:
    """Builder of a run from its frames and ticks, in the order of time."""

    def __init__(self) -> None:
        self._sessions = [_Session()]
        self._now_ns, self._delay_s = array("q"), array("d")
        self._played, self._predicted = array("b"), array("b")
        # Target and felt force of each contactor; a contactor that appears later has gaps before.
        self._forces: list[tuple[array[float], array[float]]] = []

    def begin(self) -> None:
        """Begin a session, whose clock and samples are unrelated to those before."""
        self._sessions.append(_Session())

    def add_frame(self, frame: Frame, group_delay_ns: int = 0) -> None:
        """Add the samples of a frame; the pulse is earlier than them by the group delay."""
        at_ns = np.arange(len(frame.values), dtype=np.int64) * frame.period_ns
        t_ns = frame.t_first_ns - group_delay_ns + at_ns
        self._sessions[-1].frames.append((t_ns, frame.values.astype(np.float64)))

    def add_tick(self, tick: RunTick, forces_n: Sequence[tuple[float, float]]) -> None:
        """Add a tick; forces_n: target and felt force of each contactor."""
        sensing_ns, instant_ns = tick.sensing_now_ns, tick.instant_ns
        # At a time without samples the force is NaN.
        self._sessions[-1].sensing_ns.append(-(1 << 62) if sensing_ns is None else sensing_ns)
        if sensing_ns is None or instant_ns is None:
            self._delay_s.append(np.nan)
        else:
            self._delay_s.append((sensing_ns - instant_ns) * 1e-9)
        while len(self._forces) < len(forces_n):
            gap = [np.nan] * len(self._now_ns)
            self._forces.append((array("d", gap), array("d", gap)))
        for number, (target_n, felt_n) in enumerate(self._forces):
            due, felt = forces_n[number] if number < len(forces_n) else (np.nan, np.nan)
            target_n.append(due)
            felt_n.append(felt)
        self._now_ns.append(tick.now_ns)
        self._played.append(tick.played)
        self._predicted.append(tick.predicted)

    def run(self, name: str, playback: Sequence[PlaybackStatus], summary: Summary) -> Run:
        """Return the run; playback: which channel each contactor plays, and how."""
        now_ns = np.array(self._now_ns, np.int64)
        contactors = {
            each.contactor: ContactorRun(
                each.contactor,
                np.concatenate([part.wrist_n(each.channel) for part in self._sessions]),
                np.array(target_n),
                np.array(felt_n),
                each.force_ratio,
                each.strain_per_newton,
            )
            for each, (target_n, felt_n) in zip(playback, self._forces, strict=False)
        }
        return Run(
            name,
            ((now_ns - now_ns[:1]) * 1e-9).astype(np.float64),
            np.array(self._delay_s),
            np.array(self._played, np.bool_),
            np.array(self._predicted, np.bool_),
            contactors,
            summary,
        )
