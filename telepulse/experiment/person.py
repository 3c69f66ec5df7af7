"""A person at the display's bench: keys, and intervals in real time."""

import time
from collections.abc import Callable
from typing import Literal

from display_node.display import Display
from display_node.drives.hardware import Hardware
from display_node.fault_advice import advise
from protocol.errors import BenchError
from telepulse.experiment.dialogue import HELP, Answer, Dialogue, Feel, Say, Stop
from telepulse.experiment.interval import Interval, IntervalPlayback, PlayedInterval
from telepulse.experiment.keyboard import Keyboard
from telepulse.experiment.log import Answered, now
from telepulse.experiment.pace import pace
from telepulse.experiment.session import Plan

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

    def __init__(self, plan: Plan, keyboard: Keyboard, say: Callable[[str], None]) -> None:
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
        self._display.feedback = hardware.feedback

    def stop(self) -> None:
        """End the session, an interval that is being felt at once."""
        self._stopping = True

    def answer(self, index: int, draw: Draw) -> Answered | None:
        """Ask until there is an answer; None when the session is to end. Raises BenchError."""
        session = self._plan.session
        dialogue, played = Dialogue(session.kind, session.replays), list[PlayedInterval]()
        of = len(session.conditions) * session.trials + session.catch
        self._say(f"\ntrial {index + 1} of {of}.  {HELP[session.kind]}")
        began_s = time.monotonic()
        while (key := self._await_key()) is not None:
            action = dialogue.press(key)
            if isinstance(action, Stop):
                break
            if isinstance(action, Say):
                self._say(action.text)
            elif isinstance(action, Feel):
                self._say(f"{action.letter} ...")
                felt = self._feel(draw(action.letter, action.nth))
                if felt is None:
                    break
                played.append(felt)
                self._say(f"{action.letter} is over")
            elif isinstance(action, Answer):
                return Answered(
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
            hardware = self._hardware

            def rest(now_ns: int, elapsed_ticks: int) -> bool:
                hardware.tick(self._display, now_ns, elapsed_ticks)
                self._check()
                return listen(0.0)

            pace(self._tick_ns, rest)
        return None if self._stopping else keys[0]

    def _feel(self, interval: Interval) -> PlayedInterval | None:
        """Let an interval be felt, to its end; None when the session is to end."""
        hardware = self._hardware
        if hardware is None:
            playing = IntervalPlayback(interval, time.monotonic_ns())
        else:
            playing = IntervalPlayback(
                interval, time.monotonic_ns(), hardware.feedback, hardware.tick
            )
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
