"""Events, from the statuses of a display in virtual time."""

import re

from telepulse.telemetry.events import INTERRUPTED, EventDetector
from tests.support.sender import MS, Sender, display, run

STATUS_TICKS = 200


class Watched:
    """A display with an event detector on its statuses, one each 200 ticks."""

    def __init__(self) -> None:
        self.display = display()
        self.texts: list[str] = []
        self.states: list[str] = []
        self._sender = Sender()
        self._watch = EventDetector()
        self._ms = 0

    def play(self, ticks: int, cut: bool = False) -> None:
        """Tick; cut: the samples sent meanwhile are lost."""
        for _ in range(ticks):
            if cut and self._ms % 5 == 0:
                self._sender.sent += 5
            run(self.display, None if cut else self._sender, self._ms, self._ms + 1)
            self._ms += 1
            self._publish()

    def stall(self, ms: int) -> None:
        """Stall; the frames sent meanwhile arrive together, before the next tick."""
        for at_ms in range(self._ms, self._ms + ms):
            if at_ms % 5 == 0:
                self.display.on_frame(self._sender.frame(at_ms * MS, 0.3), at_ms * MS)
        self._ms += ms
        self.display.tick(self._ms * MS, ms + 1)
        self._ms += 1
        self._publish()

    def _publish(self) -> None:
        if self.display.ticks % STATUS_TICKS:
            return
        self.states.append(self.display.state)
        summary = self.display.summary().to_dict()
        for event in self._watch.take(self.display.state, summary, self._ms * MS):
            if event.name == INTERRUPTED:
                self.texts.append(event.text)


def test_interruptions_with_a_short_pulse_between_them_are_both_named() -> None:
    watched = Watched()
    watched.play(1_500)
    watched.states.clear()
    watched.play(230, cut=True)
    while watched.display.state != "playing":
        watched.play(1)
    watched.play(20)
    watched.play(1_000, cut=True)
    # The states of the statuses alone do not show the second interruption.
    assert "playing" not in watched.states
    watched.play(1_500)
    assert len(watched.texts) == 2
    number = r"\d\.\d\d"
    form = f"after {number} s without the whole pulse: from {number} to {number} s of the run"
    assert all(re.fullmatch(form, text) for text in watched.texts)


def test_a_display_that_stood_still_names_its_interruption_once() -> None:
    watched = Watched()
    watched.play(1_500)
    watched.stall(2_600)
    watched.play(1_000)
    (text,) = watched.texts
    found = re.match(r"after (\d\.\d\d) s .* from (\d\.\d\d) to (\d\.\d\d) s of the run", text)
    assert found is not None
    without_s, began_s, ended_s = map(float, found.groups())
    # The stall and the ramp.
    assert 2.85 <= without_s <= 3.0
    assert abs(ended_s - began_s - without_s) <= 0.02
    assert abs(began_s - 1.5) <= 0.02
