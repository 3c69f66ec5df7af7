"""A run as arrays: the force at the wrist, the target force at the finger, and the felt force."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from display_node.scoring.error_sums import rms
from display_node.scoring.tracking_error import Floats, compared_forces_n, interpolate
from protocol.config.quantities import count_text
from protocol.errors import OutputError
from protocol.summary.fields import RmsErrors, Summary
from telepulse.columns import SessionColumns, join_ticks

if TYPE_CHECKING:
    import pandas as pd

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


def build_run(name: str, sessions: Sequence[SessionColumns], summary: Summary) -> Run:
    """Return the run of some sessions, with the contactors that play the last one."""
    names = list(sessions[-1].playing)
    now_ns, sensing_ns, instant_ns, playing, full, predicted = (
        join_ticks(sessions, column)
        for column in ("now_ns", "sensing_ns", "instant_ns", "playing", "full", "predicted")
    )
    return Run(
        name,
        (now_ns - now_ns[:1]) * 1e-9,
        np.where(playing, (sensing_ns - instant_ns) * 1e-9, np.nan),
        full,
        predicted,
        {contactor: _contactor_run(contactor, sessions) for contactor in names},
        summary,
    )


def _contactor_run(name: str, sessions: Sequence[SessionColumns]) -> ContactorRun:
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
        np.concatenate(wrist_n),
        target_n,
        felt_n,
        last.force_ratio,
        last.strain_per_newton,
        last.film_age_ns * 1e-9,
    )
