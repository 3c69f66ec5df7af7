"""Criteria of the study of the press, and the texts of its figures."""

from collections.abc import Sequence

from display_node.press.finger_press import PressLimits
from sensing_node.press.probe import ProbeLimits
from telepulse.document import percent
from telepulse.reports.studies.press_runs import (
    EASED_S,
    FOLLOW_ERROR,
    HEIGHT_ERROR,
    MOST_GAIN,
    FollowScore,
)
from telepulse.reports.studies.press_scores import (
    LONG_FRAMES,
    LONG_FROM_S,
    SCENE_VARIANT,
    PressScores,
)

MET, MISSED = "met", "missed"


def missed_criteria(scores: PressScores) -> str:
    """Return the finding that names every criterion that is missed, or that none is."""
    own = [run for runs in scores.follow.values() for run in runs]
    far = scene_runs(scores)
    limits, hand = ProbeLimits(), PressLimits()
    peaks, eased_s = wrist_peaks(scores), max(scores.eased_s.values())
    gain = largest_gain(scores)
    beyond = [run.beyond for run in scores.wrists.values() if not renders(run)]
    stiff = [key for key, error in scores.stiff.items() if error > FOLLOW_ERROR]
    checks = {
        "the hold-down on the study's own wrist": all(map(follows, own)),
        "the height on the study's own wrist": all(map(renders, own)),
        "the hold-down on other wrists": all(map(follows, scores.wrists.values())),
        f"the height on other wrists, in {len(beyond)} of {len(scores.wrists)} runs, in up to"
        f" {percent(max(beyond, default=0.0))} of the beats of one": not beyond,
        f"the hold-down with {len(stiff)} of {len(scores.stiff)} pairs of a stiffness and a round"
        " trip": not stiff,
        "the decay after a step": all(swing.decays for swing in scores.swing.values()),
        f"the loop's gain, {gain:.4f}": gain < MOST_GAIN,
        "the probe's limits": all(
            force_n <= limits.force_n and slew <= limits.slew_n_per_s
            for force_n, slew in peaks.values()
        ),
        "the finger's limits": within_hand(scores, hand),
        "the time to ease off": eased_s <= EASED_S,
        "the hold-down over TCP": all(map(follows, far.values())),
        "the height over TCP": all(map(renders, far.values())),
    }
    missed = [name for name, met in checks.items() if not met]
    return f"Missed: {'; '.join(missed)}." if missed else "All criteria are met."


def within_hand(scores: PressScores, limits: PressLimits) -> bool:
    """Return whether the set-points of the finger kept its limits."""
    force_n, slew = scores.finger
    # The slew of two set-points is measured over a time that is rounded to ticks.
    return force_n <= limits.force_n and slew <= 1.001 * limits.slew_n_per_s


def largest_gain(scores: PressScores) -> float:
    """Return the largest gain of all runs and of the opened loop."""
    runs = [*(run for runs in scores.follow.values() for run in runs), *scores.wrists.values()]
    return max(*(run.gain for run in runs), *(max(pair) for pair in scores.gains.values()))


def scene_runs(scores: PressScores) -> dict[float, FollowScore]:
    """Return the runs over TCP of the scenes' own variants: `press`, and from 1 s `press_far`."""
    return {
        trip_s: run
        for (trip_s, variant), run in scores.tcp.items()
        if variant == (LONG_FRAMES if trip_s >= LONG_FROM_S else SCENE_VARIANT)
    }


def verdict(met: bool) -> str:
    """Return a criterion's verdict as a word."""
    return MET if met else MISSED


def follows(score: FollowScore) -> bool:
    """Return whether every step was followed within the criterion."""
    return max(score.late) <= FOLLOW_ERROR


def renders(score: FollowScore) -> bool:
    """Return whether every beat had the height that the press would give, within the criterion."""
    return max(map(abs, score.heights)) <= HEIGHT_ERROR


def wrist_peaks(scores: PressScores) -> dict[str, tuple[float, float]]:
    """Return the greatest force and slew at the wrist, by case."""
    every = [run for runs in scores.follow.values() for run in runs]
    every += [*scores.tcp.values(), *scores.wrists.values()]
    peaks = [(run.greatest_n, run.slew_n_per_s) for run in every]
    peaks += [(swing.greatest_n, swing.slew_n_per_s) for swing in scores.swing.values()]
    return {"all runs of this study": (max(a for a, _ in peaks), max(b for _, b in peaks))} | {
        f"hostile display, tissue {tissue:g} times as stiff": peak
        for tissue, peak in scores.hostile.items()
    }


def height_text(runs: Sequence[FollowScore]) -> str:
    """Return the least and the largest error of the height."""
    least, most = min(min(run.heights) for run in runs), max(max(run.heights) for run in runs)
    return f"{percent(least, '+.1f')} to {percent(most, '+.1f')}"


def followed_steps(score: FollowScore) -> int:
    """Return the number of steps that were followed within the criterion."""
    return sum(late <= FOLLOW_ERROR for late in score.late)


def ms_text(seconds: float) -> str:
    """Return a time in ms."""
    return f"{1e3 * seconds:.0f} ms"
