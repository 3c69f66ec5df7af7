import io
from dataclasses import asdict

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from rich.console import Console

from display_node.telemetry.terminal_view import TerminalView
from protocol.faults import Fault, FaultKind, Part
from protocol.finger import FingerState
from protocol.refusals import Reason
from protocol.summary.fields import (
    Compensation,
    Loop,
    OneWayDelay,
    PlayoutDelay,
    RmsErrors,
    Roughness,
    SampleCounts,
    Summary,
)
from protocol.wire.telemetry import STATUS, TRACE, Status, Trace, pack_status
from tests.unit.display_node.telemetry.test_alerts import (
    ALERTS,
    REFUSAL,
    REFUSED,
    faults,
    waiting_for,
)

BEAT_S = 0.8
SUMMARY = Summary(
    samples=SampleCounts(1000, 890, 100, 7, 3, 0),
    one_way_delay_ms=OneWayDelay(1.25, 4.5, 9.0),
    playout_delay_ms=PlayoutDelay(12.5, 14.0),
    compensation=Compensation(0.375),
    roughness=Roughness(6e-4, 5e-4, 1.44),
    force_rmse_n=RmsErrors(1.5e-3, 2e-2),
    loop=Loop(1000, 42),
).to_dict()
FINAL = pack_status("ended", "my pulse", Summary(), final=True)
PLAYING = pack_status("playing", "my pulse", Summary(), final=False)


def pulse(seconds: float, start_s: float = 0.0) -> Trace:
    t_s = np.arange(0, seconds, 1e-3)
    phase = (t_s % BEAT_S) - 0.2
    force_n = 0.3 + 0.3 * np.exp(-0.5 * (phase / 0.05) ** 2)
    now_ns = ((t_s + start_s) * 1e9).astype(np.int64)
    return Trace(now_ns, now_ns, force_n, force_n, np.ones(len(t_s), bool))


def view(state: str = "playing", seconds: float = 6, **changes: object) -> TerminalView:
    """Return a view of a pulse of `seconds`, with changes to the summary of its status."""
    under_test = TerminalView()
    under_test.add_trace(pulse(seconds))
    under_test.status = Status(state, "my pulse", SUMMARY | changes, False)
    return under_test


def printed(
    under_test: TerminalView, now_ns: int = 0, styles: bool = False, width: int = 100
) -> str:
    console = Console(width=width, record=True, file=io.StringIO(), force_terminal=styles or None)
    console.print(under_test.live(now_ns))
    return console.export_text(styles=styles)


@pytest.mark.parametrize(("state", "changes", "expected"), ALERTS)
def test_each_alert_is_printed_once_in_full_and_shown_while_it_lasts(
    state: str, changes: dict[str, object], expected: dict[str, str]
) -> None:
    under_test = view(state, 0, **changes)
    texts = [f"{name}: {text}" for name, text in expected.items()]
    assert under_test.new_alerts() == texts
    assert under_test.new_alerts() == []
    shown = " ".join(printed(under_test).split())
    assert all(text in shown for text in texts)


@pytest.mark.parametrize(
    ("state", "cause", "line"),
    [
        (
            "waiting",
            "refused_key",
            "waiting: not connected: tcp://127.0.0.1:5556 does not allow the key of finger",
        ),
        (
            "stale",
            "revoked",
            "stale: no samples to play; revoked: tcp://127.0.0.1:5556 does not allow the key of"
            " finger",
        ),
    ],
)
def test_a_refusal_is_in_the_line_and_in_full_below_it_also_in_a_narrow_terminal(
    state: str, cause: str, line: str
) -> None:
    finger = asdict(FingerState(0.0, measured_by="model")) if state == "waiting" else {}
    under_test = view(state, 0, refused=cause, waiting_for=waiting_for(REFUSED), finger=finger)
    assert under_test.line() == line
    assert REFUSAL in " ".join(printed(under_test, width=80).split())
    # Without a terminal: once.
    assert sum(REFUSAL in text for text in under_test.new_alerts()) == 1


def test_of_two_addresses_without_a_node_the_line_has_the_first_one_s_reason() -> None:
    first, second = (f"nobody listens at tcp://10.0.{n}.17:5555, refused 12 times" for n in (0, 1))
    under_test = view("waiting", 0, waiting_for=waiting_for(Reason(first, "go"), Reason(second)))
    assert under_test.line() == f"waiting: {first}"
    reasons = (Reason(f"connecting to tcp://{host}:1") for host in "ab")
    under_test = view("waiting", 0, waiting_for=waiting_for(*reasons))
    assert under_test.line() == "waiting: connecting to tcp://a:1; connecting to tcp://b:1"


def test_the_heart_rate_is_of_the_last_seconds_at_full_strength() -> None:
    under_test = TerminalView()
    for start_s in range(0, 120, 2):
        under_test.add_trace(pulse(2, start_s))
    assert under_test.heart_rates_per_min == pytest.approx([60 / BEAT_S], rel=0.3)
    # A clock that goes back removes the earlier pulse.
    under_test.add_trace(pulse(3))
    assert under_test.heart_rates_per_min == pytest.approx([60 / BEAT_S], rel=0.02)
    trace = pulse(6)
    under_test.add_trace(trace._replace(full=trace.now_ns < 5_900_000_000))
    assert under_test.heart_rates_per_min == [None]
    # Of each contactor.
    still = pulse(6)._replace(felt_n=np.zeros(6_000))
    under_test.add_trace(still, pulse(6))
    none, rate_per_min = under_test.heart_rates_per_min
    assert none is None
    assert rate_per_min == pytest.approx(60 / BEAT_S, rel=0.02)


def test_unreadable_telemetry_is_counted_and_shown() -> None:
    under_test = TerminalView()
    for message in ((TRACE, b"?"), (STATUS, b"?"), (STATUS,), (STATUS, FINAL, b"")):
        assert under_test.take(message) == []
    assert under_test.unreadable == 4
    assert under_test.take((STATUS, PLAYING)) == []
    assert under_test.line() == "playing: telemetry not readable 4 times"


@pytest.mark.parametrize("name", ["[red]evil[/red]", "\x1b[31mevil", "[/]"])
def test_the_texts_of_a_status_cannot_draw_on_the_screen(name: str) -> None:
    fault = Fault(FaultKind.UNKNOWN, Part.FILM, name, 0, name)
    finger = asdict(FingerState(0.0, 0.0, name))
    under_test = view(**faults(fault), finger=finger, rejected={name: 1})
    assert under_test.status is not None
    under_test.status = under_test.status._replace(state=name, stream=name)
    text = printed(under_test)
    assert "\x1b" not in text + under_test.line()
    assert "evil" in text or "[/]" in text


@given(
    st.text(max_size=200),
    st.lists(st.text(max_size=300), max_size=4),
    st.text(max_size=300),
    st.floats(allow_infinity=False),
    st.integers(0, 1 << 53),
)
def test_a_status_line_has_at_most_100_characters(
    state: str, causes: list[str], finger: str, force_n: float, count: int
) -> None:
    under_test, ticks = TerminalView(), np.arange(2) * 10_000_000
    force = np.full(2, force_n)
    under_test.add_trace(Trace(ticks, ticks, force, force, np.ones(2, bool)))
    counts = SampleCounts(count, count, count, count, count, count)
    found = [Fault(FaultKind.SILENT, Part.FILM, cause, 0, cause[:9]) for cause in causes]
    fingers = FingerState(0.0, measured_by=finger)
    summary = Summary(samples=counts, faults=found, finger=fingers).to_dict()
    under_test.status = Status(state, "stream", summary, False)
    for now_ns in (0, 10**17):
        assert len(under_test.line(now_ns)) <= 100
        assert "\n" not in under_test.line(now_ns)
