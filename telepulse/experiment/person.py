"""A person at the display's bench: keys, and intervals in real time.

Dialogue of a trial, key by key. Pure, and blind: it has no access to the trial.

Keys, one at a time, from a terminal or a pipe. POSIX.
"""

import os
import re
import select
import sys
import time
from collections import Counter, deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal

from display_node.display import Display
from display_node.drives.hardware import Hardware
from display_node.fault_advice import advise
from protocol.config.quantities import count_text
from protocol.errors import BenchError, SourceError
from telepulse.experiment.interval import Interval, IntervalPlayback, PlayedInterval
from telepulse.experiment.log import AnsweredTrial, now
from telepulse.experiment.pace import pace
from telepulse.experiment.session import LETTERS, Kind, Letter, SessionPlan

STOP_KEY = "q"
ANSWERS: dict[str, dict[str, Literal["A", "B", 1, 2, 3, 4, 5]]] = {
    "abx": {"1": "A", "2": "B"},
    "rating": {"1": 1, "2": 2, "3": 3, "4": 4, "5": 5},
}
HELP: dict[str, str] = {
    "abx": "a, b, x: feel it.  1: X is A.  2: X is B.  q: stop.",
    "rating": "a: feel the direct touch.  x: feel X.  How close is X to A?"
    "  5: the same, 4: close, 3: somewhat off, 2: far, 1: nothing like it.  q: stop.",
}


@dataclass(frozen=True, slots=True)
class Present:
    """Let the subject feel an interval, for the nth time."""

    letter: Letter
    nth: int


@dataclass(frozen=True, slots=True)
class Response:
    """The trial is answered."""

    value: Literal["A", "B", 1, 2, 3, 4, 5]


@dataclass(frozen=True, slots=True)
class Hint:
    """Tell the subject why a key does nothing."""

    text: str


class EndSession:
    """The session is to end."""


class Dialogue:
    """The dialogue of one trial: keys come in, the actions they ask for go out."""

    def __init__(self, kind: Kind, replays: int | None) -> None:
        self._kind = kind
        self._replays = replays
        self._felt: Counter[str] = Counter()

    def press(self, key: str) -> Present | Response | Hint | EndSession:
        """A key was pressed."""
        letters = {letter.lower(): letter for letter in LETTERS[self._kind]}
        if key == STOP_KEY:
            return EndSession()
        if key in letters:
            return self._feel(letters[key])
        answers = ANSWERS[self._kind]
        if key not in answers:
            return Hint(HELP[self._kind])
        missing = [letter for letter in letters.values() if not self._felt[letter]]
        if missing:
            return Hint(f"feel {' and '.join(missing)} first")
        return Response(answers[key])

    def _feel(self, letter: Letter) -> Present | Hint:
        if self._replays is not None and self._felt[letter] >= self._replays:
            return Hint(
                f"{letter} was felt {count_text(self._felt[letter], 'time')}; no more in this trial"
            )
        self._felt[letter] += 1
        return Present(letter, self._felt[letter])


# What an arrow key and its like send has letters in it.
ESCAPED = re.compile(r"\x1b(\[[0-9;]*[A-Za-z~]|O[A-Za-z]|.)?")


AWAIT_S = 1.0


class Keyboard:
    """Standard input, without echo and without waiting for Enter, within a `with`."""

    def __init__(self) -> None:
        """Raises SourceError where there are no POSIX terminals."""
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
            # At once: to wait until the terminal has taken all output may be to wait for ever.
            self._termios.tcsetattr(self._descriptor, self._termios.TCSANOW, self._before)

    def key(self, wait_s: float = 0.0) -> str | None:
        """The next key in lower case, None where none comes in time; q when there are no more."""
        if not self._typed:
            self._read(wait_s)
        return self._typed.popleft() if self._typed else None

    def await_key(self) -> str:
        """Wait for the next key."""
        while True:
            key = self.key(AWAIT_S)
            if key is not None:
                return key

    def wants_to_stop(self) -> bool:
        """Return whether q is among the keys that wait. What a pipe holds is in its order, and
        waits."""
        if self._is_terminal:
            self._read(0.0)
        return self._is_terminal and STOP_KEY in self._typed

    def _read(self, wait_s: float) -> None:
        if not select.select([self._descriptor], [], [], wait_s)[0]:
            return
        # A pipe one key at a time: what comes after is read when it is asked for.
        data = os.read(self._descriptor, 64 if self._is_terminal else 1)
        if not data:
            self._typed.append(STOP_KEY)
        text = ESCAPED.sub("", data.decode(errors="ignore")).lower()
        self._typed.extend(key for key in text if not key.isspace())


NAME = "experiment"
LOOK_S = 0.1
CATCH_UP_WITHIN_S = 2.0
POLL_S = 1e-3

Draw = Callable[[Literal["A", "B", "X"], int], Interval]
"""The nth playing of a letter."""


class Person:
    """Answers trials by keyboard, on the real bench or the scene's models.

    Nothing that is printed before the session's end depends on what A, B and X are.
    """

    def __init__(self, plan: SessionPlan, keyboard: Keyboard, say: Callable[[str], None]) -> None:
        """Raises SceneError for a force loop that is not stable."""
        self._plan = plan
        self._keyboard = keyboard
        self._hardware: Hardware | None = None
        self._say = say
        self._stopping = False
        scene = plan.direct.display
        # Who holds the actuator at rest until the next interval begins.
        self._display = Display(scene, NAME, score=False)
        self._tick_ns = scene.tick_ns

    def use(self, hardware: Hardware) -> None:
        """Play on a real bench, started, in place of the scene's models."""
        self._hardware = hardware
        self._display.use(hardware)

    def stop(self) -> None:
        """End the session, an interval that is being felt at once."""
        self._stopping = True

    def answer(self, index: int, draw: Draw) -> AnsweredTrial | None:
        """Ask until there is an answer; None when the session is to end. Raises BenchError."""
        session = self._plan.session
        dialogue, played = Dialogue(session.kind, session.replays), list[PlayedInterval]()
        of = len(session.conditions) * session.trials + session.catch
        self._say(f"\ntrial {index + 1} of {of}.  {HELP[session.kind]}")
        began_s = time.monotonic()
        while (key := self._await_key()) is not None:
            action = dialogue.press(key)
            if isinstance(action, EndSession):
                break
            if isinstance(action, Hint):
                self._say(action.text)
            elif isinstance(action, Present):
                self._say(f"{action.letter} ...")
                felt = self._feel(draw(action.letter, action.nth))
                if felt is None:
                    break
                played.append(felt)
                self._say(f"{action.letter} is over")
            elif isinstance(action, Response):
                return AnsweredTrial(
                    time=now(),
                    index=index,
                    answer=action.value,
                    response_s=round(time.monotonic() - began_s, 3),
                    played=tuple(played),
                )
        return None

    def _await_key(self) -> str | None:
        """The next key; None when the session is to end. The bench rests meanwhile."""
        keys: list[str] = []

        def listen(wait_s: float) -> bool:
            key = self._keyboard.key(wait_s)
            if key is not None:
                keys.append(key)
            return not keys and not self._stopping

        if self._hardware is None:
            while listen(LOOK_S):
                pass
        else:

            def rest(now_ns: int, elapsed_ticks: int) -> bool:
                self._display.tick(now_ns, elapsed_ticks)
                self._check()
                return listen(0.0)

            pace(self._tick_ns, rest)
        return None if self._stopping else keys[0]

    def _feel(self, interval: Interval) -> PlayedInterval | None:
        """Let an interval be felt, to its end; None when the session is to end."""
        hardware = self._hardware
        playing = IntervalPlayback(interval, time.monotonic_ns(), hardware)
        if hardware is not None:
            _catch_up(hardware)
        self._display = playing.display

        def tick(now_ns: int, elapsed_ticks: int) -> bool:
            if self._stopping or self._keyboard.wants_to_stop():
                self._stopping = True
                playing.stop(now_ns)
            on = playing.tick(now_ns, elapsed_ticks)
            self._check()
            return on

        pace(self._tick_ns, tick)
        return None if self._stopping else playing.played()

    def _check(self) -> None:
        if faults := self._display.safety.faults:
            raise BenchError(
                f"the session stops: {'; '.join(faults)} ({advise(faults[0])}); answered trials are"
                " in the log,"
                " and --resume goes on with it"
            )


def _catch_up(hardware: Hardware) -> None:
    """Hear what the film said while a display was being built, and nothing ticked. A film that
    has gone for good is the display's fault to find."""
    until_s = time.monotonic() + CATCH_UP_WITHIN_S
    while not hardware.feedback.alive(time.monotonic_ns()) and time.monotonic() < until_s:
        hardware.read()
        time.sleep(POLL_S)
