"""Trust in the predictor: on predictable pulses, and on pulses that become unpredictable.

The pulses are those of `telepulse study prediction`, with 0.3 N on a static force and 0.5 mN of
noise. Pulses that change do so after `TURN_S`; all are scored from then on.
"""

import tempfile
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from benchmarks.measure import show
from display_node.scoring.tracking_error import JND
from protocol.config.scene_file import find_scene
from protocol.ticks import TickState
from sensing_node.sources.recorded import RecordingScene
from sensing_node.sources.synthetic import NOMINAL_BEAT_S
from telepulse.reports.studies.prediction_pulses import (
    RATE_HZ,
    Beats,
    Floats,
    breathing,
    drawn,
    fibrillating,
    make_rhythm,
    through_chain,
    with_ectopics,
)
from telepulse.reports.studies.sweep import sweep
from telepulse.scene import Scene, load_scene
from telepulse.simulation.link_scene import parse_link
from telepulse.simulation.virtual_time import STREAM_BEGINS_NS, Simulation

SECONDS, TURN_S = 60.0, 40.0
SEEDS = (1, 2, 3)
SETS = ("variability", "ramp", "ectopic", "fibrillation", "movement")
SIZE_N, STATIC_N, NOISE_N = 0.3, 0.6, 5e-4
# Hold-down force of a moving hand, which changes twice a second.
SHIFT_N, SHIFTS_HZ = 0.1, 2
SETTLED_NS = 1_000_000


@dataclass(frozen=True, slots=True)
class Case:
    """A pulse of `SETS` over a link."""

    pulse: str
    link: str
    seed: int


@dataclass(frozen=True, slots=True)
class Score:
    """Figures from the turn on.

    trusted: share of the time with trust. lost_s: time at which trust was first lost; None if
    never, or if there was none at the turn. errors_n: errors in phase while trusted with E = 0.
    """

    trusted: float
    lost_s: float | None
    errors_n: Floats


def show_trust(links: dict[str, str]) -> None:
    """Print the table: links as `parse_link` reads them, by name. Uses all cores."""
    cases = [Case(pulse, link, seed) for pulse in SETS for link in links.values() for seed in SEEDS]
    scores = dict(zip(cases, sweep(score, cases), strict=True))
    rows = []
    for pulse in SETS:
        for name, link in links.items():
            each = [scores[Case(pulse, link, seed)] for seed in SEEDS]
            rows.append((pulse, name, *_figures(each)))
    show(
        f"the stack at E = auto, {TURN_S:g} to {SECONDS:g} s of {len(SEEDS)} pulses: share of the"
        " time trusted; when that is lost (s, the latest); while trusted, at E = 0: RMSE in phase"
        " over the pulse's height, and share of the time within a tenth of it",
        ("pulse", "link", "trusted", "lost after", "RMSE", "within JND"),
        rows,
    )


def score(case: Case) -> Score:
    """Play a case."""
    true_n = pulse_n(case.pulse, case.seed)
    noise = np.random.default_rng((case.seed, 1)).standard_normal(len(true_n))
    now_s, errors_n, trusted, delay_ns = [], [], [], []

    def watch(felt: TickState) -> None:
        sample = round((felt.now_ns - STREAM_BEGINS_NS) * RATE_HZ * 1e-9)
        if sample < len(true_n):
            now_s.append(sample / RATE_HZ)
            errors_n.append(felt.felt_n - true_n[sample])
            trusted.append(felt.trusted)
            delay_ns.append(felt.playout_delay_ns)

    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "pulse.npy")
        np.save(path, true_n + NOISE_N * noise)
        Simulation(_scene(path, case.link), case.seed).run(SECONDS, TURN_S, watch)
    settled = np.array(trusted) & (np.array(delay_ns) < SETTLED_NS)
    lost_at = int(np.argmin(trusted)) if trusted[0] and not all(trusted) else None
    return Score(
        float(np.mean(trusted)),
        None if lost_at is None else now_s[lost_at] - TURN_S,
        np.array(errors_n)[settled],
    )


def pulse_n(name: str, seed: int) -> Floats:
    """Return one of `SETS`, at 1 kHz, without noise."""
    rng = np.random.default_rng((seed, SETS.index(name)))
    calm = make_rhythm(rng, SECONDS, 0.04, lambda _: 75.0)
    ramp = make_rhythm(rng, SECONDS, 0.0, lambda t_s: 60 + 60 * t_s / SECONDS)
    match name:
        case "ramp":
            unit = drawn(ramp, "wide", SECONDS, 1.0)
        case "ectopic":
            unit = _wide(with_ectopics(make_rhythm(rng, SECONDS, 0.02, lambda _: 75.0), rng, 20))
        case "fibrillation":
            before = calm.intervals_s[: np.searchsorted(np.cumsum(calm.intervals_s), TURN_S)]
            after = fibrillating(rng, SECONDS - TURN_S)
            intervals_s = np.concatenate([before, after.intervals_s])
            unit = _wide(Beats(intervals_s, np.ones(len(intervals_s))))
        case _:
            unit = breathing(_wide(calm))
    begins, turns = RATE_HZ * round(TURN_S / 2), RATE_HZ * round(TURN_S)
    force_n = through_chain(unit)
    force_n *= SIZE_N / np.ptp(force_n[begins:turns])
    if name == "movement":
        shifts_n = SHIFT_N * rng.standard_normal(round((SECONDS - TURN_S) * SHIFTS_HZ))
        moved_n = np.repeat(shifts_n, RATE_HZ // SHIFTS_HZ)
        force_n[turns:] += through_chain(np.concatenate([[0.0], moved_n]))[1:]
    return np.asarray(STATIC_N + force_n)


def _wide(beats: Beats) -> Floats:
    return drawn(beats, "wide", SECONDS, NOMINAL_BEAT_S)


def _scene(pulse: Path, link: str) -> Scene:
    radial = load_scene(find_scene("radial"))
    table = {"path": str(pulse), "rate": f"{RATE_HZ} Hz", "unit": "N", "repeat": "once"}
    source = RecordingScene.model_validate({"kind": "recording", **table})
    return replace(
        radial,
        sensing=radial.sensing.model_copy(update={"source": source}),
        display=radial.display.model_copy(update={"predictor": "stack"}),
        link=parse_link(link),
    )


def _figures(scores: list[Score]) -> tuple[str, ...]:
    errors_n = np.concatenate([each.errors_n for each in scores])
    lost_s = [each.lost_s for each in scores if each.lost_s is not None]
    trusted = f"{np.mean([each.trusted for each in scores]):.2f}"
    lost = f"{max(lost_s):.1f}" if lost_s else "–"
    if not len(errors_n):
        return trusted, lost, "–", "–"
    rmse = float(np.sqrt(np.mean(errors_n**2))) / SIZE_N
    return trusted, lost, f"{rmse:.1%}", f"{np.mean(np.abs(errors_n) < JND * SIZE_N):.1%}"
