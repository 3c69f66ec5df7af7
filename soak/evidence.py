"""From what a soak has seen to what can be judged."""

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from display_node.scene import DisplayScene
from sensing_node.sources.synthetic import SyntheticScene
from soak.accounts import Session, reckon
from soak.core_time import NONE_EXCUSED, excuse
from soak.processes import SoakProcess
from soak.recovery import beside, gaps_s, recoveries
from soak.run import MINUTE_S, Run
from soak.scenario import CALM_DISPLAY, CALM_SENSING, TORMENTED
from soak.schedule import ENDURING, GUEST, MORTAL, PORTS, SENSING
from soak.truth import judge_ends, judge_events, judge_lines, judge_stalls, judge_statuses
from soak.verdict import (
    MEGA,
    Check,
    Line,
    LoopFigures,
    judge_account,
    judge_calm_loop,
    judge_loop,
    judge_none,
    judge_recovery,
    judge_safety,
    judge_untouched,
    judge_usage,
)

# Until buffers and histograms are full, and Python's arenas are as torn as they get.
WARM_UP_S = 480.0
ROLES = (CALM_SENSING, CALM_DISPLAY, SENSING, ENDURING, MORTAL)
# What a killed node's last frame may be heard after, and an impostor's, of which we keep no life.
HEARD_WITHIN_NS = 100_000_000


def verdict(run: Run, scene: DisplayScene, wrist_per_min: float | None) -> list[Check]:
    """All checks of a soak but that of what it leaves behind.

    wrist_per_min: heart rate of the source; None where it has none, and none is judged.
    """
    safety, felt = scene.safety, run.taps.felt
    lives = {role: [x for x in run.stage.all_lives if x.role == role] for role in (*ROLES, GUEST)}
    checks = [
        check for role in ROLES for check in judge_usage(role, [_line(x) for x in lives[role]])
    ]
    calm = _loop_figures(lives[CALM_DISPLAY], scene.tick_ns)
    checks += judge_calm_loop(calm)
    for role in (ENDURING, MORTAL):
        checks += judge_loop(role, _loop_figures(lives[role], scene.tick_ns), calm)
    for role in (CALM_DISPLAY, *TORMENTED):
        checks += judge_safety(role, felt[role], safety.force_limit_n, safety.slew_limit_n_per_s)
    checks += _judge_accounts(run, lives)
    checks += judge_recovery(recoveries(run.played, felt))
    calm_gaps = gaps_s(run.played, felt[CALM_DISPLAY])
    checks += judge_untouched(beside(run.played, felt), calm_gaps)
    checks += _judge_truth(run, lives, scene, wrist_per_min)
    complaints = [text for life in run.stage.all_lives if (text := life.complaint())]
    checks.append(judge_none("bad ends", [*complaints, *run.stage.complaints]))
    return checks


def heart_rate_per_min(source: object) -> float | None:
    """Return the heart rate that a source is made with; None for one that is recorded or live."""
    return source.heart_rate_hz * MINUTE_S if isinstance(source, SyntheticScene) else None


def _judge_truth(
    run: Run, lives: dict[str, list[SoakProcess]], scene: DisplayScene, wrist_per_min: float | None
) -> Iterator[Check]:
    """Judge what displays claimed against what was recorded."""
    impostors = [
        (done.began_ns, done.over_ns)
        for played in run.played
        for done in played.done
        if done.fault.kind == "impostor"
    ]
    for role in (CALM_DISPLAY, *TORMENTED):
        claims = [life.claims for life in lives[role]]
        record = run.taps.records[role]
        yield from judge_statuses(role, claims, scene.tick_ns)
        yield judge_events(role, claims, record.interruptions)
        faded_ns = scene.safety.stale_after_ns + scene.safety.fade_ns + 2 * scene.tick_ns
        yield judge_stalls(role, claims, record.gaps, faded_ns)
    for role, lines in run.terminals.lines.items():
        known = [] if role == CALM_DISPLAY else impostors
        yield from judge_lines(role, lines, run.taps.records[role], wrist_per_min, known)
    yield judge_ends(
        [
            (role, life.process.returncode, summary, life.claims[-1] if life.claims else None)
            for role in (CALM_DISPLAY, *TORMENTED)
            for life in lives[role]
            if life.ending == "stopped" and (summary := life.result_summary()) is not None
        ]
    )


def _judge_accounts(run: Run, lives: dict[str, list[SoakProcess]]) -> Iterator[Check]:
    sessions = {role: list(_sessions(run, role, lives[role])) for role in (SENSING, CALM_SENSING)}
    yield judge_none("sensing nodes that miscounted what was heard", _miscounted(run, lives))
    for role in (CALM_DISPLAY, *TORMENTED):
        heard = sessions[CALM_SENSING if role == CALM_DISPLAY else SENSING]
        faults = [] if role == CALM_DISPLAY else _faults(run, role)
        reckonings = [
            reckoning
            for life in lives[role]
            if life.marks
            for reckoning in reckon(
                life.marks,
                [x for x in heard if x.ended_ns > life.began_ns and x.began_ns < _end_ns(life)],
                faults,
            )
        ]
        yield judge_account(role, reckonings)
    last = [life.summary for life in run.stage.all_lives if life.summary]
    yield judge_none("clock steps", [str(x["clock"]["steps"]) for x in last if x["clock"]["steps"]])
    yield judge_none("faults latched", [fault for x in last for fault in x["faults"]])
    calm = next((life.summary for life in lives[CALM_DISPLAY] if life.summary), None)
    refused = [f"{count} {cause}" for cause, count in (calm["rejected"] if calm else {}).items()]
    lost = [f"{calm['samples']['lost']} lost"] if calm and calm["samples"]["lost"] else []
    yield judge_none("refused by, or lost to the calm display", [*refused, *lost])


def _sessions(run: Run, role: str, lives: Sequence[SoakProcess]) -> Iterator[Session]:
    """The sessions of a sensing node's role in order, an impostor's among them."""
    for heard in sorted(run.taps.sessions[role].values(), key=lambda heard: heard.began_ns):
        life = _life_of(heard.began_ns, lives)
        said = life.sent() if life is not None else None
        if said is not None:
            least = most = said
        else:
            end_ns = heard.last_ns + HEARD_WITHIN_NS if life is None else _end_ns(life)
            least = heard.sent
            most = max(least, (end_ns - heard.began_ns) // heard.period_ns + heard.batch)
        yield Session(heard.began_ns, heard.last_ns, heard.period_ns, least, most)


def _miscounted(run: Run, lives: dict[str, list[SoakProcess]]) -> list[str]:
    found = []
    for role in (SENSING, CALM_SENSING):
        for heard in run.taps.sessions[role].values():
            life = _life_of(heard.began_ns, lives[role])
            said = life.sent() if life is not None else None
            if said is not None and said != heard.sent:
                found.append(f"{role} sent {said}, {heard.sent} were heard")
    return found


def _life_of(began_ns: int, lives: Sequence[SoakProcess]) -> SoakProcess | None:
    return next((x for x in lives if x.began_ns <= began_ns <= _end_ns(x)), None)


def _end_ns(life: SoakProcess) -> int:
    return life.over_ns or 1 << 62


def _faults(run: Run, role: str) -> list[tuple[int, int]]:
    """Times at which something was done to a display or to its sensing node."""
    return [
        (done.began_ns, played.over_ns(role) or done.over_ns)
        for played in run.played
        for done in played.done
        if done.fault.kind != "guest"
        and (role in done.displays or done.fault.target in (SENSING, PORTS))
    ]


def _line(life: SoakProcess) -> Line:
    rows = [(x.at_ns * 1e-9, x.memory_bytes / MEGA, x.descriptors, x.threads) for x in life.usage]
    warm = sum(x.at_ns - life.began_ns <= WARM_UP_S * 1e9 for x in life.usage)
    times_s, memory_mb, handles, threads = np.array(rows, float).reshape(-1, 4).T
    return Line(times_s, memory_mb, handles, threads, warm)


def _loop_figures(lives: Sequence[SoakProcess], tick_ns: int) -> LoopFigures:
    loops: list[tuple[dict[str, Any], int]] = [
        (life.summary["loop"], life.frozen_ns // tick_ns) for life in lives if life.summary
    ]
    if not loops:
        return LoopFigures(0, 0, 0.0)
    ticks = sum(loop["ticks"] for loop, _ in loops)
    misses = sum(max(0, loop["deadline_misses"] - frozen) for loop, frozen in loops)
    longest, _ = max(loops, key=lambda pair: pair[0]["ticks"])
    excused = sum((excuse(x.misses, x.core_times, tick_ns) for x in lives), NONE_EXCUSED)
    return LoopFigures(ticks, misses, longest["tick_us"]["p99"] or 0.0, excused)
