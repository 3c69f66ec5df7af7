"""Collect the checks of a soak from its records."""

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from display_node.scene import DisplayScene
from protocol.faults import faults_of
from sensing_node.sources.synthetic import SyntheticScene
from soak.accounts import Session, reckon, unaccounted
from soak.core_time import NONE_EXCUSED, excuse
from soak.faults import gaps_s, recoveries, undisturbed_gaps_s
from soak.felt import FeltLog
from soak.processes import SoakProcess
from soak.run import MINUTE_S, Run
from soak.scenario import CALM_DISPLAY, CALM_SENSING, DISTURBED
from soak.schedule import CONTINUOUS, PORTS, RESTARTED, SENSING, TEMPORARY
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

# Time until buffers and histograms are full, and the fragmentation of Python's arenas is steady.
WARM_UP_S = 480.0
ROLES = (CALM_SENSING, CALM_DISPLAY, SENSING, CONTINUOUS, RESTARTED)
# The last frame of a killed node, or of an impostor, may be received up to this time after its end.
RECEIVED_WITHIN_NS = 100_000_000


def verdict(run: Run, scene: DisplayScene, wrist_per_min: float | None) -> list[Check]:
    """Return all checks of a soak except that of its leftovers.

    wrist_per_min: heart rate of the source; None if it is unknown, and heart rates are not judged.
    """
    safety, felt = scene.safety, run.taps.felt
    nodes = {
        role: [x for x in run.scenario.all_nodes if x.role == role] for role in (*ROLES, TEMPORARY)
    }
    checks = [
        check for role in ROLES for check in judge_usage(role, [_line(x) for x in nodes[role]])
    ]
    loops = {
        role: _loop_figures(nodes[role], felt[role])
        for role in (CALM_DISPLAY, CONTINUOUS, RESTARTED)
    }
    calm = loops.pop(CALM_DISPLAY)
    checks += judge_calm_loop(calm)
    for role, figures in loops.items():
        checks += judge_loop(role, figures, calm)
    for role in (CALM_DISPLAY, *DISTURBED):
        checks += judge_safety(
            role, felt[role].bounds(), safety.force_limit_n, safety.slew_limit_n_per_s
        )
    checks += _judge_accounts(run, nodes)
    checks += judge_recovery(recoveries(run.played, felt))
    calm_gaps = gaps_s(run.played, felt[CALM_DISPLAY])
    checks += judge_untouched(undisturbed_gaps_s(run.played, felt), calm_gaps)
    checks += _judge_truth(run, nodes, scene, wrist_per_min)
    complaints = [text for node in run.scenario.all_nodes if (text := node.complaint())]
    checks.append(judge_none("bad ends", [*complaints, *run.scenario.complaints]))
    return checks


def heart_rate_per_min(source: object) -> float | None:
    """Return the heart rate of a synthetic source; None for a recorded or a live one."""
    return source.heart_rate_hz * MINUTE_S if isinstance(source, SyntheticScene) else None


def _judge_truth(
    run: Run, nodes: dict[str, list[SoakProcess]], scene: DisplayScene, wrist_per_min: float | None
) -> Iterator[Check]:
    """Judge the statements of displays against the record."""
    impostors = [
        (done.began_ns, done.over_ns)
        for played in run.played
        for done in played.done
        if done.fault.kind == "impostor"
    ]
    for role in (CALM_DISPLAY, *DISTURBED):
        claims = [node.claims for node in nodes[role]]
        felt = run.taps.felt[role]
        yield from judge_statuses(role, claims, scene.tick_ns)
        yield judge_events(role, claims, felt.interruptions)
        faded_ns = scene.safety.stale_after_ns + scene.safety.fade_ns + 2 * scene.tick_ns
        yield judge_stalls(role, claims, felt.gaps, faded_ns)
    for role, lines in run.terminals.lines.items():
        known = [] if role == CALM_DISPLAY else impostors
        yield from judge_lines(role, lines, run.taps.felt[role], wrist_per_min, known)
    yield judge_ends(
        [
            (role, node.process.returncode, summary, node.claims[-1] if node.claims else None)
            for role in (CALM_DISPLAY, *DISTURBED)
            for node in nodes[role]
            if node.ending == "stopped" and (summary := node.result_summary()) is not None
        ]
    )


def _judge_accounts(run: Run, nodes: dict[str, list[SoakProcess]]) -> Iterator[Check]:
    sessions = {role: list(_sessions(run, role, nodes[role])) for role in (SENSING, CALM_SENSING)}
    yield judge_none("sensing nodes that miscounted", _miscounted(run, nodes))
    for role in (CALM_DISPLAY, *DISTURBED):
        streamed = sessions[CALM_SENSING if role == CALM_DISPLAY else SENSING]
        faults = [] if role == CALM_DISPLAY else _faults(run, role)
        reckonings = [
            reckoning
            for node in nodes[role]
            if node.marks
            for reckoning in reckon(
                node.marks,
                [x for x in streamed if x.ended_ns > node.began_ns and x.began_ns < _end_ns(node)],
                faults,
            )
        ]
        yield judge_account(role, reckonings)
    last = [node.summary for node in run.scenario.all_nodes if node.summary]
    yield judge_none("clock steps", [str(x["clock"]["steps"]) for x in last if x["clock"]["steps"]])
    yield judge_none("faults latched", [str(fault) for x in last for fault in faults_of(x)])
    yield judge_none("set-points unaccounted", unaccounted([x["press"] for x in last]))
    calm = next((node.summary for node in nodes[CALM_DISPLAY] if node.summary), None)
    rejected = calm["rejected"] | calm["rejected_readers"] if calm else {}
    refused = [f"{count} {cause}" for cause, count in rejected.items()]
    lost = [f"{calm['samples']['lost']} lost"] if calm and calm["samples"]["lost"] else []
    yield judge_none("refused by, or lost to the calm display", [*refused, *lost])


def _sessions(run: Run, role: str, nodes: Sequence[SoakProcess]) -> Iterator[Session]:
    """Yield the sessions of a sensing node's role in order, an impostor's included."""
    for received in sorted(
        run.taps.sessions[role].values(), key=lambda received: received.began_ns
    ):
        node = _node_of(received.began_ns, nodes)
        reported = node.sent() if node is not None else None
        if reported is not None:
            least = most = reported
        else:
            end_ns = received.last_ns + RECEIVED_WITHIN_NS if node is None else _end_ns(node)
            least = received.sent
            most = max(least, (end_ns - received.began_ns) // received.period_ns + received.batch)
        yield Session(received.began_ns, received.last_ns, received.period_ns, least, most)


def _miscounted(run: Run, nodes: dict[str, list[SoakProcess]]) -> list[str]:
    found = []
    for role in (SENSING, CALM_SENSING):
        for received in run.taps.sessions[role].values():
            node = _node_of(received.began_ns, nodes[role])
            reported = node.sent() if node is not None else None
            if reported is not None and reported != received.sent:
                found.append(f"{role} reported {reported} samples, {received.sent} were received")
    return found


def _node_of(began_ns: int, nodes: Sequence[SoakProcess]) -> SoakProcess | None:
    return next((x for x in nodes if x.began_ns <= began_ns <= _end_ns(x)), None)


def _end_ns(node: SoakProcess) -> int:
    return node.over_ns or 1 << 62


def _faults(run: Run, role: str) -> list[tuple[int, int]]:
    """Return the times of faults of a display or of its sensing node."""
    return [
        (done.began_ns, played.over_ns(role) or done.over_ns)
        for played in run.played
        for done in played.done
        if done.fault.kind != "temporary display"
        and (role in done.displays or done.fault.target in (SENSING, PORTS))
    ]


def _line(node: SoakProcess) -> Line:
    rows = [(x.at_ns * 1e-9, x.memory_bytes / MEGA, x.descriptors, x.threads) for x in node.usage]
    warm = sum(x.at_ns - node.began_ns <= WARM_UP_S * 1e9 for x in node.usage)
    times_s, memory_mb, handles, threads = np.array(rows, float).reshape(-1, 4).T
    return Line(times_s, memory_mb, handles, threads, warm)


def _loop_figures(nodes: Sequence[SoakProcess], felt: FeltLog) -> LoopFigures:
    loops: list[tuple[dict[str, Any], int]] = [
        (node.summary["loop"], node.frozen_ns // felt.tick_ns) for node in nodes if node.summary
    ]
    if not loops:
        return LoopFigures(0, 0, 0.0)
    ticks = sum(loop["ticks"] for loop, _ in loops)
    misses = sum(max(0, loop["deadline_misses"] - frozen) for loop, frozen in loops)
    longest, _ = max(loops, key=lambda pair: pair[0]["ticks"])
    gaps, excused = felt.misses, NONE_EXCUSED
    for node in nodes:
        its_own = [gap for gap in gaps if node.began_ns <= gap[0] <= _end_ns(node)]
        excused += excuse(its_own, node.core_times, felt.tick_ns)
    return LoopFigures(ticks, misses, longest["tick_us"]["p99"] or 0.0, excused)
