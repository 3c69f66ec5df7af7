"""How often the page is drawn: less often where the display on the same computer misses ticks."""

import pytest
from bokeh.document import Document

from telepulse.telemetry.schema import TICK
from telepulse.view.live import LiveState
from telepulse.view.page import LivePage
from tests.support.page_states import MS, SimulatedDisplay

PERIODS = 40


def redraws(missed: float | None, local: bool = True, state: str = "playing") -> int:
    """Return how often the curves are drawn in 40 periods of a display that misses ticks."""
    display = SimulatedDisplay(LiveState())
    deadlines = {} if missed is None else {"last_5s": {"missed": missed, "gap_ms": 4.0}}
    display.go(1, state, loop={"ticks": 500, "deadline_misses": 9} | deadlines)
    document = Document()
    page = LivePage(document, display.live, lambda: 0, lambda _: None, local)
    force = document.get_model_by_name("force")
    texts, choices, _ = force.tags
    drawn: list[str] = []
    force.renderers[0].data_source.on_change("data", lambda attr, old, new: drawn.append(attr))
    for _ in range(PERIODS):
        display.at_ns += 200 * MS
        display.frame()
        display.take(TICK, display.at_ns, now_ns=display.at_ns, scored=False, felt_n=0.1)
        # The answer of a browser to the last update.
        choices.data = {**choices.data, "seen": [texts.data["shown"][0]["number"]]}
        page.draw()
    return len(drawn)


@pytest.mark.parametrize(
    ("missed", "periods"), [(None, 1), (0.0, 1), (0.0009, 1), (0.0011, 2), (0.0031, 4), (0.2, 5)]
)
def test_a_page_gives_way_to_a_loop_that_misses_ticks(missed: float | None, periods: int) -> None:
    assert redraws(missed) == PERIODS // periods


def test_a_page_on_another_computer_is_drawn_in_every_period() -> None:
    assert redraws(0.2, local=False) == PERIODS


@pytest.mark.parametrize("state", ["waiting", "stale", "fault"])
def test_a_state_without_a_pulse_is_drawn_in_every_period(state: str) -> None:
    assert redraws(0.2, state=state) == PERIODS
