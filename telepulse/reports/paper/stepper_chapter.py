"""The chapter on the physical stepper: the paper's pulse, its error beaten, and what does it."""

from typing import TYPE_CHECKING

from telepulse.commissioning.tuning import Design, judge
from telepulse.reports.document import Chapter, Plot, Table
from telepulse.reports.paper import numbers
from telepulse.reports.paper import stepper as bench
from telepulse.reports.paper.experiment import ExperimentRun
from telepulse.reports.paper.stepper import StepperTrial

if TYPE_CHECKING:
    from matplotlib.figure import Figure

SHOWN_S = (3.0, 4.8)


def chapter() -> Chapter:
    """Runs the benches. Raises SceneError or SourceError."""
    clean, real = bench.clean_bench(), bench.real_bench()
    floor_mn = 1e3 * bench.floor_n(clean)
    papers_mn = 1e3 * numbers.EXPERIMENT_FORCE_RMSE_N
    knowing = bench.controllers(clean), bench.controllers(real)
    return Chapter(
        "The same pulse on a physical stepper",
        (
            "Eq 22 is not a stepping motor. Here the paper's pulse, 0.3 N from peak to peak on"
            " 0.3 N, is pressed by one: 1/16 microsteps on a lead of 2 mm, a rigid tip of 5 mm on"
            " 2 mm of rubber, a fingertip of 1 N/mm behind it. The clean bench is that and"
            " nothing else. The real bench adds 10 µm of backlash, a rotor that rings at 100 Hz"
            " (ζ 0.2), 1 mN of noise on the film, its 40 Hz filter, and a converter of 16 bits"
            " over ±10 V, which at Fig. 4's 44 mV/N is 6.9 mN a step. All errors are force RMSE"
            " over the first 6 s, as the paper's; scenes bench and real_bench.",
            f"One microstep is what a stepper can do: the nearest one at every tick would leave"
            f" {floor_mn:.2f} mN. The paper's experiment printed {papers_mn:.1f} mN.",
            "Three things do it. Feed-forward: the reference's next samples are known, so the"
            " screw is driven where contact, rotor and backlash will have it, before any error"
            " shows. An observer: twins of drive and film are stepped along, so that the film's"
            " lag is known and not mistaken for an error. And the finger is learnt: its place and"
            " its softness are states of the observer's Kalman filter.",
            "Feed-forward alone makes the real bench worse than a plain gain does: the slow film"
            " reports the motion late, and the gain works against it.",
        ),
        (
            _knowing_table(*knowing),
            _parts_table(),
            _list_table(
                "The controller is wrong about the real bench",
                "it is really",
                bench.mistakes(),
            ),
            _list_table("Other benches", "bench", bench.other_benches()),
            _margins_table(
                judge(clean.display, clean.display.controller),
                judge(real.display, real.display.controller),
            ),
        ),
        (_plot(*bench.tracking()),),
    )


def _knowing_table(clean: list[StepperTrial], real: list[StepperTrial]) -> Table:
    on_clean = {trial.name: _millinewtons(trial) for trial in clean}
    rows = tuple(
        (trial.name, on_clean.get(trial.name, "–"), _millinewtons(trial)) for trial in real
    )
    refused = [trial.refused for trial in real if trial.refused]
    return Table(
        "Force RMSE by what the controller knows",
        ("controller", "clean bench", "real bench"),
        rows,
        note="Refused: " + "; ".join(refused) if refused else "",
    )


def _parts_table() -> Table:
    rows = tuple(
        (reading.name, _millinewtons(reading), _millinewtons(observed))
        for reading, observed in bench.parts()
    )
    return Table(
        "What each part of the real bench costs alone",
        ("part", "with feed-forward, on the film's reading", "with the observer"),
        rows,
    )


def _list_table(title: str, first: str, trials: list[StepperTrial]) -> Table:
    rows = tuple((trial.name, _millinewtons(trial)) for trial in trials)
    return Table(title, (first, "force RMSE"), rows)


def _margins_table(clean: Design, real: Design) -> Table:
    def row(name: str, design: Design) -> tuple[str, ...]:
        worst = design.worst
        return (
            name,
            f"{design.controller.kp:g} /s",
            f"{worst.gain:.3g}",
            f"{worst.phase_deg:.0f}°",
            f"{1e3 * worst.delay_s:.3g} ms",
            f"{worst.peak_sensitivity:.2f}",
        )

    return Table(
        "Margins of the two loops, as `telepulse tune` designs them",
        ("loop", "kp", "gain margin", "phase margin", "delay margin", "Ms"),
        (row("clean bench", clean), row("real bench", real)),
        note="The observer's gains solve a Riccati equation for the film's noise and a finger"
        " that wanders 20 µm in 1 s; kp makes least what is felt of both, as long as Ms stays"
        " at or below 1.4 and the drive may answer 5 ticks late.",
    )


def _millinewtons(trial: StepperTrial) -> str:
    if trial.force_rmse_n is None:
        return "refused"
    return f"{1e3 * trial.force_rmse_n:.2f} mN"


def _plot(blind: ExperimentRun, ours: ExperimentRun) -> Plot:
    def draw(figure: "Figure") -> None:
        force, error = figure.subplots(2, sharex=True, height_ratios=(3, 2))
        shown = (ours.t_s >= SHOWN_S[0]) & (ours.t_s < SHOWN_S[1])
        t_s = ours.t_s[shown]
        force.plot(t_s, ours.wanted_n[shown], label="wanted")
        force.plot(t_s, blind.felt_n[shown], label="proportional gain, film's reading")
        force.plot(t_s, ours.felt_n[shown], "--", label="as shipped")
        force.set(ylabel="force in N", ylim=(0.2, 0.7))
        force.legend(loc="upper right", ncols=3)
        error.plot([], [])
        for run in (blind, ours):
            error.plot(t_s, 1e3 * (run.felt_n - run.wanted_n)[shown])
        error.set(xlabel="time in s", ylabel="error in mN")

    return Plot(
        "real-bench",
        "The real bench: force at the finger with the film's reading taken for the force, and"
        " with feed-forward and observer.",
        draw,
    )
