"""How often the page is drawn: less often where the display on the same computer misses ticks."""

import pytest
from bokeh.document import Document

from telepulse.telemetry.schema import TICK
from telepulse.view.live import LiveState
from telepulse.view.page import LivePage
from tests.unit.telepulse.view.page_states import MS, SimulatedDisplay

PERIODS = 40


def redraws(missed: float | None, local: bool, state: str) -> int:
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
    ("missed", "local", "state", "periods"),
    [
        (None, True, "playing", 1),
        (0.0009, True, "playing", 1),
        (0.0011, True, "playing", 2),
        (0.0031, True, "playing", 4),
        (0.2, True, "playing", 5),
        (0.2, False, "playing", 1),
        (0.2, True, "fault", 1),
    ],
)
def test_a_page_on_this_computer_gives_way_to_a_loop_that_misses_ticks(
    missed: float | None, local: bool, state: str, periods: int
) -> None:
    assert redraws(missed, local, state) == PERIODS // periods
