"""The run of a session, from its first trial or from its first one without an answer."""

from collections.abc import Callable
from functools import partial
from importlib.metadata import version
from pathlib import Path
from random import SystemRandom

from telepulse.experiment.interval import (
    IntervalPlayback,
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
    read_log,
)
from telepulse.experiment.person import DrawInterval
from telepulse.experiment.psychometrics import IntervalErrors, SimulatedObserver
from telepulse.experiment.session import LETTERS, SessionPlan, draw_trials
from telepulse.scene import scene_provenance

Subject = Callable[[int, DrawInterval], AnsweredTrial | None]
"""Answers a trial by its index and intervals; None ends the session."""


def open_log(
    path: Path, plan: SessionPlan, threshold: float | None, resume: bool
) -> tuple[SessionLogFile, SessionHeader, int]:
    """Return the log to write, its header, and the number of answered trials.

    A log that is resumed must have the same session, scene and observer. Raises LogError or
    OutputError.
    """
    made_up = plan.direct.display.drive is None or threshold is not None
    if not resume:
        seed = plan.session.seed
        seed = SystemRandom().getrandbits(31) if seed is None else seed
        header = SessionHeader(
            version=version("telepulse"),
            time=now(),
            tables=plan.tables,
            seed=seed,
            threshold=threshold,
            trials=draw_trials(plan.session, seed),
            felt_on="models" if made_up else "drive",
            provenance=scene_provenance(plan.direct, {"session": seed}).to_dict(),
        )
        file = SessionLogFile(path)
        file.write(header)
        return file, header, 0
    log = read_log(path)
    if (log.header.tables, log.header.threshold) != (plan.tables, threshold):
        raise LogError(f"{path}: session, scene or observer differ from those of its begin")
    file = SessionLogFile(path, log.whole_bytes)
    made = scene_provenance(plan.direct, {"session": log.header.seed}).to_dict()
    file.write(ResumedSession(version=version("telepulse"), time=now(), provenance=made))
    return file, log.header, len(log.answered)


def check_playable(plan: SessionPlan, header: SessionHeader) -> None:
    """Check that an interval of each condition can be played. Raises SceneError or SourceError."""
    checked = set()
    for index, trial in enumerate(header.trials):
        if trial.condition not in checked:
            checked.add(trial.condition)
            for letter in LETTERS[plan.session.kind]:
                IntervalPlayback(draw_interval(plan, header.seed, index, trial, letter, 1), 0)


def run_session(
    plan: SessionPlan, file: SessionLogFile, header: SessionHeader, done: int, subject: Subject
) -> bool:
    """Run trial after trial and log each; return whether all are answered."""
    for index in range(done, len(header.trials)):
        draw = partial(draw_interval, plan, header.seed, index, header.trials[index])
        answered = subject(index, draw)
        if answered is None:
            return False
        file.write(answered)
    return True


def simulated_subject(plan: SessionPlan, threshold: float, seed: int) -> Subject:
    """Return an observer that feels each interval once, in virtual time, on the scene's models."""
    kind = plan.session.kind

    def answer(index: int, draw: DrawInterval) -> AnsweredTrial:
        # An observer for each trial: a resumed session has the same answers as an unbroken one.
        observer = SimulatedObserver(threshold, seed * 100_000 + index)
        played = [play_in_virtual_time(draw(letter, 1)) for letter in LETTERS[kind]]
        a, b, x = (error_share(played, letter) for letter in ("A", "B", "X"))
        value = observer.identify(IntervalErrors(a, b, x)) if kind == "abx" else observer.rate(a, x)
        return AnsweredTrial.model_validate(
            {"time": now(), "index": index, "answer": value, "response_s": None, "played": played}
        )

    return answer
