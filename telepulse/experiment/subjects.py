"""The subjects of a session, a person at the bench or a simulated observer, and the session's run.

A person feels intervals in real time, and answers by keys.
"""

import os
import re
import sys
import time
from collections import Counter, deque
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, BinaryIO, NamedTuple

from display_node.display import Display
from display_node.hardware import Hardware
from protocol.config.quantities import count_text
from protocol.errors import BenchError, SourceError
from protocol.host.descriptors import await_readable
from protocol.host.realtime import Pacer
from telepulse.experiment.interval import (
    Interval,
    IntervalPlayback,
    PlayedInterval,
    draw_interval,
    interval_errors,
    play_in_virtual_time,
)
from telepulse.experiment.log import Answer, AnsweredTrial, SessionHeader, write_line
from telepulse.experiment.observer import SimulatedObserver
from telepulse.experiment.session import LETTERS, Kind, Letter, SessionPlan

NAME = "experiment"
STOP_KEY = "q"
ANSWERS: dict[str, dict[str, Answer]] = {
    "abx": {"1": "A", "2": "B"},
    "rating": {"1": 1, "2": 2, "3": 3, "4": 4, "5": 5},
}
HELP: dict[str, str] = {
    "abx": "a, b, x: feel it.  1: X is A.  2: X is B.  q: stop.",
    "rating": "a: feel the direct touch.  x: feel X.  How close is X to A?"
    "  5: the same, 4: close, 3: somewhat off, 2: far, 1: nothing like it.  q: stop.",
}
# Escape sequences, such as those of arrow keys, contain letters that must not act as keys.
ESCAPED = re.compile(r"\x1b(\[[0-9;]*[A-Za-z~]|O[A-Za-z]|.)?")
KEY_WAIT_S = 0.1
FILM_WITHIN_S = 2.0
POLL_S = 1e-3

DrawInterval = Callable[[Letter, int], Interval]
"""Function that returns the nth playing of a letter."""
Subject = Callable[[int, DrawInterval], "Answered | None"]
"""Function that answers a trial, given its index and intervals; None ends the session."""


class Answered(NamedTuple):
    """The answer of a trial, the intervals felt for it, and the time to it.

    A subject has no access to the trial.
    """

    answer: Answer
    played: Sequence[PlayedInterval]
    response_s: float | None = None


class Action(NamedTuple):
    """Action of a key: present a letter for the nth time, answer the trial, or print a hint."""

    present: Letter | None = None
    nth: int = 0
    answer: Answer | None = None
    hint: str = ""


class Dialogue:
    """The dialogue of one trial: keys in, actions out. Pure.

    It has no access to the trial, so nothing it prints can depend on what A, B and X are.
    """

    def __init__(self, kind: Kind, replays: int | None) -> None:
        self._kind = kind
        self._replays = replays
        self._presented: Counter[str] = Counter()

    def press(self, key: str) -> Action | None:
        """Return the action of a key; None if it ends the session."""
        letters = {letter.lower(): letter for letter in LETTERS[self._kind]}
        answers = ANSWERS[self._kind]
        if key == STOP_KEY:
            return None
        if key in letters:
            letter = letters[key]
            count = self._presented[letter]
            if self._replays is not None and count >= self._replays:
                felt = count_text(count, "time")
                return Action(hint=f"{letter} was felt {felt}; no more in this trial")
            self._presented[letter] += 1
            return Action(present=letter, nth=count + 1)
        if key not in answers:
            return Action(hint=HELP[self._kind])
        missing = [letter for letter in letters.values() if not self._presented[letter]]
        if missing:
            return Action(hint=f"feel {' and '.join(missing)} first")
        return Action(answer=answers[key])


class Keyboard:
    """Context in which keys are read from standard input, a terminal or a pipe.

    Keys need no Enter and are not shown. Raises SourceError on a system without POSIX terminals.
    """

    def __init__(self) -> None:
        try:
            import termios
            import tty
        except ImportError:
            raise SourceError(
                "keys are read from POSIX terminals, and this system has none"
            ) from None
        self._termios: Any = termios
        self._tty: Any = tty
        self._descriptor = sys.stdin.fileno()
        self._is_terminal = os.isatty(self._descriptor)
        self._typed: deque[str] = deque()

    def __enter__(self) -> "Keyboard":
        if self._is_terminal:
            self._before = self._termios.tcgetattr(self._descriptor)
            self._tty.setcbreak(self._descriptor, self._termios.TCSANOW)
        return self

    def __exit__(self, *_: object) -> None:
        if self._is_terminal:
            # TCSANOW, because the other modes wait for pending output: for ever on a terminal
            # that is stopped by Ctrl-S.
            self._termios.tcsetattr(self._descriptor, self._termios.TCSANOW, self._before)

    def key(self, wait_s: float = 0.0) -> str | None:
        """Return the next key in lower case: None if none comes in time, q at the input's end."""
        if not self._typed:
            self._read(wait_s)
        return self._typed.popleft() if self._typed else None

    def await_key(self) -> str:
        """Wait for the next key."""
        while (key := self.key(KEY_WAIT_S)) is None:
            pass
        return key

    def wants_to_stop(self) -> bool:
        """Return whether q was typed on a terminal; the keys of a pipe are read one by one."""
        if self._is_terminal:
            self._read(0.0)
        return self._is_terminal and STOP_KEY in self._typed

    def _read(self, wait_s: float) -> None:
        if not await_readable(self._descriptor, wait_s):
            return
        # A pipe is read one byte at a time, so that later keys stay in it.
        data = os.read(self._descriptor, 64 if self._is_terminal else 1)
        if not data:
            self._typed.append(STOP_KEY)
        text = ESCAPED.sub("", data.decode(errors="ignore")).lower()
        self._typed.extend(key for key in text if not key.isspace())


class Person:
    """Person who answers trials by keyboard, on the real bench or on the scene's models.

    The output before the end of the session does not depend on what A, B and X are. Raises
    SceneError for a force loop that is not stable.
    """

    def __init__(self, plan: SessionPlan, keyboard: Keyboard, show: Callable[[str], None]) -> None:
        self._plan = plan
        self._keyboard = keyboard
        self._hardware: Hardware | None = None
        self._show = show
        self._stopping = False
        scene = plan.direct.display
        # Holds the actuator at rest until the next interval begins.
        self._display = Display(scene, NAME, score=False)
        self._tick_ns = scene.tick_ns

    def use(self, hardware: Hardware) -> None:
        """Play on a started real bench instead of the scene's models."""
        self._hardware = hardware
        self._display.use(hardware)

    def stop(self) -> None:
        """End the session, and a running interval at once."""
        self._stopping = True

    def answer(self, index: int, draw: DrawInterval) -> Answered | None:
        """Run a trial until its answer; return None if the session ends. Raises BenchError."""
        session = self._plan.session
        dialogue, played = Dialogue(session.kind, session.replays), list[PlayedInterval]()
        count = len(session.conditions) * session.trials + session.catch
        self._show(f"\ntrial {index + 1} of {count}.  {HELP[session.kind]}")
        began_s = time.monotonic()
        while (key := self._await_key()) is not None and (
            action := dialogue.press(key)
        ) is not None:
            if action.hint:
                self._show(action.hint)
            elif action.present is not None:
                self._show(f"{action.present} ...")
                interval = self._play(draw(action.present, action.nth))
                if interval is None:
                    break
                played.append(interval)
                self._show(f"{action.present} is over")
            elif action.answer is not None:
                return Answered(action.answer, played, round(time.monotonic() - began_s, 3))
        return None

    def _await_key(self) -> str | None:
        """Return the next key, or None if the session ends; the bench rests meanwhile."""
        key: str | None = None

        def rest(now_ns: int, elapsed_ticks: int) -> bool:
            nonlocal key
            self._display.tick(now_ns, elapsed_ticks)
            self._check()
            key = self._keyboard.key()
            return key is None and not self._stopping

        _run_ticks(self._tick_ns, rest)
        return None if self._stopping else key

    def _play(self, interval: Interval) -> PlayedInterval | None:
        """Play an interval to its end; return None if the session ends."""
        hardware = self._hardware
        playing = IntervalPlayback(interval, time.perf_counter_ns(), hardware)
        if hardware is not None:
            _await_film(hardware)
        self._display = playing.display

        def tick(now_ns: int, elapsed_ticks: int) -> bool:
            if self._stopping or self._keyboard.wants_to_stop():
                self._stopping = True
                playing.stop(now_ns)
            playing_on = playing.tick(now_ns, elapsed_ticks)
            self._check()
            return playing_on

        _run_ticks(self._tick_ns, tick)
        return None if self._stopping else playing.played()

    def _check(self) -> None:
        if faults := self._display.fade.faults:
            raise BenchError(
                f"the session stops: {'; '.join(map(str, faults))} ({faults[0].remedy}); the log"
                " has the answered trials, and --resume continues it"
            )


def _await_film(hardware: Hardware) -> None:
    """Read the film until its readings are current; return also if it stays silent.

    Building a display takes a while, in which nothing is read. The display reports a silent film.
    """
    until_s = time.monotonic() + FILM_WITHIN_S
    while not hardware.feedback.alive(time.perf_counter_ns()) and time.monotonic() < until_s:
        hardware.read()
        time.sleep(POLL_S)


def _run_ticks(tick_ns: int, tick: Callable[[int, int], bool]) -> None:
    """Call tick(due_ns, elapsed_ticks) when it is due, until it returns False."""
    pacer, goes_on = Pacer(tick_ns, time.perf_counter_ns()), True
    while goes_on:
        now_ns = time.perf_counter_ns()
        begun = pacer.begin(now_ns)
        if begun is None:
            time.sleep((pacer.due_ns - now_ns) * 1e-9)
        else:
            goes_on = tick(begun.due_ns, begun.elapsed_ticks)


def check_playable(plan: SessionPlan, header: SessionHeader) -> None:
    """Check that an interval of each condition can be played. Raises SceneError or SourceError."""
    checked = set()
    for index, trial in enumerate(header.trials):
        if trial.condition not in checked:
            checked.add(trial.condition)
            for letter in LETTERS[plan.session.kind]:
                IntervalPlayback(draw_interval(plan, header.seed, index, trial, letter, 1), 0)


def run_session(
    plan: SessionPlan, file: BinaryIO, header: SessionHeader, done: int, subject: Subject
) -> bool:
    """Run trial after trial and log each; return whether all are answered."""
    for index in range(done, len(header.trials)):
        trial = header.trials[index]
        answered = subject(index, partial(draw_interval, plan, header.seed, index, trial))
        if answered is None:
            return False
        write_line(file, AnsweredTrial.of(index, trial, *answered))
    return True


def simulated_subject(plan: SessionPlan, threshold: float, seed: int) -> Subject:
    """Return an observer that feels each interval once, in virtual time, on the scene's models."""
    kind = plan.session.kind

    def answer(index: int, draw: DrawInterval) -> Answered:
        # An observer for each trial: a resumed session has the same answers as an unbroken one.
        observer = SimulatedObserver(threshold, seed * 100_000 + index)
        played = [play_in_virtual_time(draw(letter, 1)) for letter in LETTERS[kind]]
        a, b, x = interval_errors(played)
        value = observer.identify(a, b, x) if kind == "abx" else observer.rate(a, x)
        return Answered(value, played)

    return answer
