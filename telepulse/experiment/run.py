"""A session from its first trial to its last, or from where it was left."""

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from random import SystemRandom
from typing import Literal

from protocol.errors import SceneError
from telepulse.experiment.interval import (
    IntervalPlayback,
    PlayedInterval,
    draw_interval,
    error_share,
    play_in_virtual_time,
)
from telepulse.experiment.log import (
    AnsweredTrial,
    LogError,
    ResumedSession,
    SessionHeader,
    SessionLogFile,
    now,
    our_version,
    read_log,
)
from telepulse.experiment.person import Draw
from telepulse.experiment.psychometrics import IntervalErrors, SimulatedObserver
from telepulse.experiment.session import LETTERS, SessionPlan, draw_trials
from telepulse.scene import scene_provenance

Subject = Callable[[int, Draw], AnsweredTrial | None]
"""Answers a trial by its index and intervals; None: no more."""


def open_log(
    path: Path, plan: SessionPlan, threshold: float | None, resume: bool
) -> tuple[SessionLogFile, SessionHeader, int]:
    """The log to write, its header, and how many trials are answered.

    A log that goes on must be of the same session, scene and observer; its trials are taken from
    it. Raises LogError or OutputError.
    """
    drive = plan.direct.display.drive
    felt_on: Literal["drive", "models"] = (
        "models" if drive is None or threshold is not None else "drive"
    )
    if not resume:
        seed = plan.session.seed
        seed = SystemRandom().getrandbits(31) if seed is None else seed
        header = SessionHeader(
            version=our_version(),
            time=now(),
            tables=plan.tables,
            seed=seed,
            threshold=threshold,
            trials=draw_trials(plan.session, seed),
            felt_on=felt_on,
            provenance=scene_provenance(plan.direct, {"session": seed}).to_dict(),
        )
        file = SessionLogFile(path)
        file.write(header)
        return file, header, 0
    log = read_log(path)
    if (log.header.tables, log.header.threshold) != (plan.tables, threshold):
        raise LogError(f"{path}: session, scene or observer are not those it began with")
    file = SessionLogFile(path, log.whole_bytes)
    made = scene_provenance(plan.direct, {"session": log.header.seed}).to_dict()
    file.write(ResumedSession(version=our_version(), time=now(), provenance=made))
    return file, log.header, len(log.answered)


def check_drive(plan: SessionPlan, without_drive: bool) -> None:
    """Refuse a person a scene without a drive, unless it is asked for. Raises SceneError."""
    if plan.direct.display.drive is None and not without_drive:
        raise SceneError(
            f"{plan.direct.path}: names no [display.drive], so nobody would feel anything:"
            " --without-drive runs its models, to try a session"
        )


def check_playable(plan: SessionPlan, header: SessionHeader) -> None:
    """Check before anything moves that an interval of each condition can be played.

    Raises SceneError or SourceError.
    """
    first = {trial.condition: index for index, trial in reversed(list(enumerate(header.trials)))}
    for index in first.values():
        for letter in LETTERS[plan.session.kind]:
            IntervalPlayback(
                draw_interval(plan, header.seed, index, header.trials[index], letter, 1), 0
            )


def run_session(
    plan: SessionPlan, file: SessionLogFile, header: SessionHeader, done: int, subject: Subject
) -> bool:
    """Ask trial after trial, and log each; whether all are answered."""
    for index in range(done, len(header.trials)):
        draw = partial(draw_interval, plan, header.seed, index, header.trials[index])
        answered = subject(index, draw)
        if answered is None:
            return False
        file.write(answered)
    return True


def simulated(plan: SessionPlan, threshold: float, seed: int) -> Subject:
    """An observer that feels each interval once, in virtual time, on the scene's models."""
    kind = plan.session.kind

    def answer(index: int, draw: Draw) -> AnsweredTrial:
        # An observer of each trial's own: one that resumes answers as one that never stopped.
        observer = SimulatedObserver(threshold, seed * 100_000 + index)
        played = [_play(draw, letter) for letter in LETTERS[kind]]
        a, b, x = (error_share(played, letter) for letter in ("A", "B", "X"))
        value = observer.tell(IntervalErrors(a, b, x)) if kind == "abx" else observer.rate(a, x)
        return AnsweredTrial.model_validate(
            {"time": now(), "index": index, "answer": value, "response_s": None, "played": played}
        )

    return answer


def _play(draw: Draw, letter: str) -> PlayedInterval:
    interval = draw(letter, 1)  # type: ignore[arg-type]
    scene = interval.scene
    display = scene.display.model_copy(update={"drive": None, "feedback": None})
    return play_in_virtual_time(replace(interval, scene=replace(scene, display=display)))
