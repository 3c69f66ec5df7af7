"""Chapters on the stability of the press, its limits, and TCP."""

from typing import TYPE_CHECKING

from display_node.press.finger_press import PressLimits
from display_node.press.loop_gain import MOST_GAIN as BOUNDED_GAIN
from sensing_node.press.probe import ProbeLimits
from telepulse.document import STYLES, Chapter, Plot, Table, percent
from telepulse.reports.studies.press_criteria import (
    followed_steps,
    follows,
    height_text,
    largest_gain,
    ms_text,
    renders,
    scene_runs,
    verdict,
    within_hand,
    wrist_peaks,
)
from telepulse.reports.studies.press_runs import (
    BAND_HZ,
    EASED_S,
    FOLLOW_ERROR,
    HEIGHT_ERROR,
    MOST_GAIN,
    REST_N,
    WINDOW_S,
    WINDOWS,
)
from telepulse.reports.studies.press_scores import (
    LONG_FRAMES,
    LONG_FROM_S,
    SCENE_VARIANT,
    PressScores,
    TcpVariant,
)

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def stability_chapter(scores: PressScores) -> Chapter:
    """Return the chapter on what swings on after a step, and on the loop's gain."""
    trips = sorted({trip_s for trip_s, *_ in scores.swing})
    rows = []
    for trip_s in trips:
        swings = [swing for (at_s, *_), swing in scores.swing.items() if at_s == trip_s]
        largest = [max(1e3 * swing.rms_n[number] for swing in swings) for number in range(WINDOWS)]
        cells = {
            f"{number * WINDOW_S:g} to {(number + 1) * WINDOW_S:g} s": f"{rms_mn:.2f}"
            for number, rms_mn in enumerate(largest)
        }
        decays = verdict(all(swing.decays for swing in swings))
        rows.append({"round trip": ms_text(trip_s), **cells, "criterion": decays})

    def draw(figure: "Figure") -> None:
        axes = figure.add_subplot()
        middles_s = [WINDOW_S * (number + 0.5) for number in range(WINDOWS)]
        for style, trip_s in zip(STYLES, trips, strict=False):
            swings = [swing for (at_s, *_), swing in scores.swing.items() if at_s == trip_s]
            rms_mn = [max(1e3 * swing.rms_n[i] for swing in swings) for i in range(WINDOWS)]
            axes.plot(middles_s, rms_mn, style, label=ms_text(trip_s))
        axes.set(yscale="log", xlabel="time after the step (s)", ylabel="RMS of the set-point (mN)")
        axes.legend()

    stiffness = sorted({tissue for _, tissue, _ in scores.swing})
    gains = [
        {
            "pulse's share in the reading": f"{share:g}",
            "opened loop": f"{measured:.4f}",
            "as the finger measures it": f"{bound:.4f}",
            "criterion": verdict(max(measured, bound) < MOST_GAIN),
        }
        for share, (measured, bound) in scores.gains.items()
    ]
    words = (
        "After a step the hand means a constant force. Energy of the set-point between"
        f" {BAND_HZ[0]:g} and {BAND_HZ[1]:g} Hz, as RMS in mN over windows of {WINDOW_S:g} s,"
        " from 0.5 s and a round trip after the step on: the largest over finger and tissue of each"
        f" {', '.join(f'{each:g}' for each in stiffness)} times the model's stiffness. Criterion:"
        " no"
        f" window has more than the one before it, or than {1e3 * REST_N:g} mN. What is in the"
        " first window is the hand, which follows a tip that yields.",
        "The gain is measured with the loop opened at the wrist, which is pressed by steps of its"
        " own while the hand means a constant force: the largest change of the set-point over that"
        f" of the hold-down. It is compared with the bound {MOST_GAIN:g} of the small-gain"
        " argument; below 1 no delay can make the loop swing. The set-point follows the press by a"
        f" smaller share while the gain would be above {BOUNDED_GAIN:g}.",
    )
    tables = (
        Table.of("What swings on after a step: RMS of the set-point (mN)", rows),
        Table.of("Gain of the loop through the network", gains),
    )
    plot = Plot("swing", "RMS of the set-point after a step, the worst finger and tissue.", draw)
    gain = largest_gain(scores)
    finding = (
        "After a step nothing swings on, for any round trip, finger or tissue:"
        f" {verdict(all(swing.decays for swing in scores.swing.values()))}. The loop's gain is at"
        f" most {gain:.4f} (criterion: below {MOST_GAIN:g},"
        f" {verdict(gain < MOST_GAIN)})."
    )
    return Chapter("Stability", words, tables, (plot,), (finding,))


def limits_chapter(scores: PressScores) -> Chapter:
    """Return the chapter on forces and slews, and on cuts."""
    limits = ProbeLimits()
    cases, hand = wrist_peaks(scores), PressLimits()
    rows = [
        {
            "case": name,
            "force (N)": f"{force_n:.2f}",
            "slew (N/s)": f"{slew:.1f}",
            "criterion": verdict(force_n <= limits.force_n and slew <= limits.slew_n_per_s),
        }
        for name, (force_n, slew) in cases.items()
    ]
    finger_n, finger_slew = scores.finger
    rows.append(
        {
            "case": "set-points of the finger, hostile wrist",
            "force (N)": f"{finger_n:.2f}",
            "slew (N/s)": f"{finger_slew:.1f}",
            "criterion": verdict(within_hand(scores, hand)),
        }
    )
    eased = {
        tissue: max(time_s for (at, _), time_s in scores.eased_s.items() if at == tissue)
        for tissue, _ in scores.eased_s
    }
    times = [
        {
            "tissue": f"{tissue:g} times",
            "eased off": f"{time_s:.2f} s",
            "criterion": verdict(time_s <= EASED_S),
        }
        for tissue, time_s in eased.items()
    ]
    words = (
        f"Limits at the wrist: {limits.force_n:g} N and {limits.slew_n_per_s:g} N/s; of the"
        f" finger's set-points: {hand.force_n:g} N and {hand.slew_n_per_s:g} N/s. The hostile wrist"
        " reports random forces up to 9·10⁵ N. The hostile"
        " display sends 1600 set-points a second of 0 to 10⁶ N, repeated, out of order, and of two"
        " runs.",
        "Time from the last set-point that arrives before a cut, pressed with 2.5 N, until the"
        f" force is within 0.05 N of the resting {limits.resting_n:g} N: the longest over the round"
        " trips.",
    )
    tables = Table.of("Largest force and slew", rows), Table.of("Eased off after a cut", times)
    force_n, slew = (max(values) for values in zip(*cases.values(), strict=True))
    within = force_n <= limits.force_n and slew <= limits.slew_n_per_s
    finding = (
        f"No display makes the probe press with more than {force_n:.2f} N or {slew:.1f} N/s"
        f" (limits: {limits.force_n:g} N and {limits.slew_n_per_s:g} N/s, {verdict(within)});"
        " after a cut it"
        f" eases off within {max(eased.values()):.2f} s (criterion: at most {EASED_S:g} s,"
        f" {verdict(max(eased.values()) <= EASED_S)})."
    )
    return Chapter("Limits and cuts", words, tables, findings=(finding,))


def tcp_chapter(scores: PressScores) -> Chapter:
    """Return the chapter on the press over TCP."""
    rows = [
        {
            "round trip": ms_text(trip_s),
            "connections": f"{variant.connections}"
            + (", each twice" if variant.copies > 1 else ""),
            "frames": f"{variant.batch} ms over {variant.paths}",
            "steps followed": f"{followed_steps(run)} of {len(run.late)}",
            "applied": f"{run.account.applied} of {run.account.sent}",
            "height": height_text([run]),
            "scene": _scene_of(trip_s, variant),
            "criteria": f"{verdict(follows(run))}, {verdict(renders(run))}",
        }
        for (trip_s, variant), run in scores.tcp.items()
    ]
    words = (
        "The same over TCP with 1 % of its packets lost, where everything after a lost packet waits"
        " 1.25 round trips for its repetition. From a round trip of 240 ms on this is longer than"
        f" the {ProbeLimits().stale_after_ns * 1e-6:.0f} ms after which the probe eases off, and 50"
        " set-points a second lose one every 2 s. Set-points take turns over several connections,"
        " of which some may stall; where each is sent twice, over two, both stall as often as one."
        " The frames stall as well: from 1 s on, 200 a second over one connection leave the finger"
        " blind, and it sends nothing; fewer frames, over several connections, do not."
    )
    tables = (Table.of("Steps over TCP", rows),) if rows else ()
    if not (runs := scene_runs(scores)):
        return Chapter("Over TCP", (words,), tables)
    finding = (
        "Over TCP with 1 % of the packets lost, the hold-down follows the press within"
        f" {percent(max(max(run.late) for run in runs.values()))} (criterion: at most"
        f" {percent(FOLLOW_ERROR, '.0f')}, {verdict(all(map(follows, runs.values())))}), and the"
        f" height is {height_text(list(runs.values()))} off (criterion: at most"
        f" {percent(HEIGHT_ERROR, '.0f')}, {verdict(all(map(renders, runs.values())))}): with the"
        f" scene press, and from a round trip of {ms_text(LONG_FROM_S)} on with press_far."
    )
    return Chapter("Over TCP", (words,), tables, findings=(finding,))


def _scene_of(trip_s: float, variant: TcpVariant) -> str:
    if variant == LONG_FRAMES:
        return "press_far"
    return "press" if variant == SCENE_VARIANT else "none"
