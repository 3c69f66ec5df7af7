import io
import itertools
import math
import subprocess
import sys
import time
from collections.abc import Callable

import numpy as np
import pytest
import zmq
from hypothesis import given
from hypothesis import strategies as st
from rich.console import Console

from display_node.telemetry import terminal as screen_module
from display_node.telemetry.terminal import TerminalView, watch
from protocol.counters import Limited, Limits
from protocol.errors import CAUSE_MEANINGS
from protocol.run_summary import Summary
from protocol.sockets import Context
from protocol.summary_tables import (
    AlignedErrors,
    Compensation,
    Loop,
    OneWayDelay,
    PlayoutDelay,
    Roughness,
    SampleCounts,
)
from protocol.wire.telemetry import (
    STATUS,
    TRACE,
    Status,
    TickState,
    Trace,
    TraceWriter,
    pack_status,
)
from tests.support.nodes import free_address

BEAT_S = 0.8
SECOND_NS = 1_000_000_000


def trace_of_a_pulse(seconds: float) -> Trace:
    t_s = np.arange(0, seconds, 1e-3)
    phase = (t_s % BEAT_S) - 0.2
    force_n = 0.3 + 0.3 * np.exp(-0.5 * (phase / 0.05) ** 2)
    now_ns = (t_s * 1e9).astype(np.int64)
    return Trace(now_ns, now_ns, force_n, force_n, np.ones(len(t_s), bool))


def status() -> Status:
    summary = Summary(
        samples=SampleCounts(1000, 990, 7, 3, 0),
        one_way_delay_ms=OneWayDelay(1.25, 4.5, 9.0),
        playout_delay_ms=PlayoutDelay(12.5, 14.0),
        compensation=Compensation(0.375),
        roughness=Roughness(6e-4, 5e-4, 1.44),
        strain_rmse=AlignedErrors(1.5e-9, 2e-8),
        loop=Loop(1000, 42),
    )
    return Status("playing", "my pulse", summary.to_dict(), False)


def printed(screen: TerminalView) -> str:
    console = Console(width=100, record=True, file=io.StringIO())
    console.print(screen.panel())
    return console.export_text()


def test_the_panel_shows_what_a_person_watches() -> None:
    screen = TerminalView()
    screen.add_trace(trace_of_a_pulse(6))
    screen.status = status()
    text = printed(screen)
    for word in ("my pulse", "playing", "75 /min", "1.500e-09", "1.25 ms", "4.50 ms", "12.50 ms"):
        assert word in text
    for word in ("37.5 %", "energy ratio 1.44"):
        assert word in text
    for count in ("7", "3", "42"):
        assert count in text


def test_the_line_shows_the_same_in_one_line() -> None:
    screen = TerminalView()
    screen.add_trace(trace_of_a_pulse(6))
    screen.status = status()
    line = screen.line()
    assert "\n" not in line
    assert line.startswith("playing: heart rate 75 /min, force target")


def test_a_fault_is_named_with_what_to_do_in_line_and_panel() -> None:
    screen = TerminalView()
    summary = status().summary | {"faults": ["feedback lost"], "finger": "pressed with 245 mN"}
    screen.status = status()._replace(state="fault", summary=summary)
    said = (
        "fault: feedback lost: check the film's sensor and its cable; then start the display"
        " again; finger: pressed with 245 mN"
    )
    assert screen.new_alerts() == [said]
    assert screen.new_alerts() == []
    line = screen.line()
    assert line.startswith("fault: feedback lost: check the film's")
    assert line.endswith("finger pressed with 245 mN")
    assert said in " ".join(printed(screen).replace("│", " ").split())


def test_a_revoked_display_is_named_until_it_plays_again() -> None:
    screen = TerminalView()
    summary = status().summary | {"rejected": {"revoked": 4}}
    screen.status = status()._replace(state="stale", summary=summary)
    assert "stale: revoked: the other node allowed this" in screen.line()
    screen.status = status()._replace(summary=summary)
    assert "revoked" not in screen.line()


def test_a_limit_is_shown_where_it_was_reached() -> None:
    screen = TerminalView()
    screen.status = status()
    assert "at a limit" not in printed(screen)
    limits = Limits(force=Limited(312, 4.1, 0.205), travel=Limited(1, 0.5, 0.025))
    summary = Summary(limited=limits).to_dict()
    screen.status = screen.status._replace(summary=summary)
    assert "force limit 312 times, 4.1 s (20.5 % of the run)" in printed(screen)


@pytest.mark.parametrize(
    ("state", "rejected", "named"),
    [
        ("waiting", {"refused_key": 1}, True),
        ("stale", {"not_authentic": 319}, True),
        ("waiting", {"handshake": 3}, True),
        # A node that ends breaks off.
        ("stale", {"handshake": 2}, False),
        ("playing", {"refused_key": 9}, False),
        ("waiting", {"session": 4}, False),
    ],
)
def test_a_display_that_does_not_get_in_shows_why(
    state: str, rejected: dict[str, int], named: bool
) -> None:
    screen = TerminalView()
    summary = status().summary | {"rejected": rejected}
    screen.status = status()._replace(state=state, summary=summary)
    ((cause, count),) = rejected.items()
    assert (
        f"not connected: {count} {cause}: {CAUSE_MEANINGS[cause]}" in str(screen.new_alerts())
    ) == named
    assert ("not connected" in screen.line()) == named


def test_the_plot_is_a_line_without_holes() -> None:
    screen = TerminalView()
    screen.add_trace(trace_of_a_pulse(3))
    screen.status = status()
    rows = [
        [ord(c) - 0x2800 for c in line if 0x2800 <= ord(c) <= 0x28FF]
        for line in printed(screen).splitlines()
        if any(0x2801 <= ord(c) <= 0x28FF for c in line)
    ]
    columns = np.array(rows).T
    assert columns.shape == (64, 6)
    assert (columns.max(axis=1) > 0).all()


def test_before_anything_is_known_it_says_so() -> None:
    screen = TerminalView()
    assert "waiting" in printed(screen)
    assert "waiting" in screen.line()
    screen.status = Status("waiting", "", Summary().to_dict(), False)
    assert "no pulse yet" in printed(screen)


def test_only_the_last_seconds_are_kept() -> None:
    screen = TerminalView()
    for start_s in range(0, 120, 2):
        trace = trace_of_a_pulse(2)
        shifted = trace._replace(now_ns=trace.now_ns + start_s * 10**9)
        screen.add_trace(shifted)
    rate = screen.heart_rate_per_min
    assert rate is not None
    assert math.isclose(rate, 60 / BEAT_S, rel_tol=0.3)


FINAL = pack_status("ended", "my pulse", Summary(), final=True)


def test_what_cannot_be_read_is_counted_shown_and_ends_nothing(context: Context) -> None:
    address, looks = free_address(), 0
    publisher = context.socket(zmq.PUB)
    publisher.bind(address)

    def look() -> bool:
        nonlocal looks
        looks += 1
        for message in ((TRACE, b"?"), (STATUS, b"?"), (TRACE,), (STATUS, FINAL, b"")):
            publisher.send_multipart(message)
        if looks > 20:
            publisher.send_multipart((STATUS, FINAL))
        return looks < 1_000

    last = watch(address, Console(file=io.StringIO()), draw=False, meanwhile=look)
    assert last is not None
    assert last.final
    screen = TerminalView()
    for message in ((TRACE, b"?"), (STATUS, b"?"), (STATUS,), (STATUS, FINAL, b"")):
        assert screen.take(message) is None
    assert screen.take((STATUS, FINAL)) is None
    assert "telemetry not readable" in printed(screen)


def test_a_display_that_stands_still_is_waited_for(
    context: Context, monkeypatch: pytest.MonkeyPatch
) -> None:
    address, looks = free_address(), 0
    publisher = context.socket(zmq.PUB)
    publisher.bind(address)
    hours_s = itertools.count(0.0, 3600.0)
    monkeypatch.setattr(screen_module.time, "monotonic", lambda: next(hours_s))

    def look() -> bool:
        nonlocal looks
        looks += 1
        if looks > 10:
            publisher.send_multipart((STATUS, FINAL))
        return looks < 1_000

    assert watch(address, Console(file=io.StringIO()), draw=False, meanwhile=look) is not None


@pytest.mark.parametrize("name", ["[red]evil[/red]", "\x1b[31mevil", "[/]"])
def test_the_texts_of_a_status_cannot_draw_on_the_screen(name: str) -> None:
    screen = TerminalView()
    texts = {"faults": [name], "finger": name, "rejected": {name: 1}}
    screen.status = status()._replace(stream=name, summary=status().summary | texts)
    text = printed(screen)
    assert "\x1b" not in text + screen.line()
    assert "evil" in text or "[/]" in text


def test_what_is_not_current_has_its_age_and_no_heart_rate() -> None:
    screen = TerminalView()
    screen.add_trace(trace_of_a_pulse(6))
    screen.take(
        (STATUS, pack_status("playing", "my pulse", Summary(), final=False)), 10 * SECOND_NS
    )
    assert screen.line(10 * SECOND_NS).startswith("playing: heart rate 75 /min")
    late_ns = 12_300_000_000
    assert screen.line(late_ns).startswith("playing 2.3 s ago: no telemetry: since 2 s; finger:")
    console = Console(width=100, record=True, file=io.StringIO(), force_terminal=True)
    console.print(screen.panel(late_ns))
    assert "playing 2.3 s ago" in console.export_text(clear=False)
    # Grey: every figure is dim, none is bold.
    styled = console.export_text(styles=True)
    assert "\x1b[2m" in styled
    assert "\x1b[1m" not in styled


def test_a_display_that_has_ended_is_not_old() -> None:
    screen = TerminalView()
    screen.take((STATUS, FINAL), 0)
    assert screen.line(60 * SECOND_NS).startswith("ended: ")


def test_a_clock_that_begins_anew_begins_the_pulse_anew() -> None:
    screen = TerminalView()
    later = trace_of_a_pulse(6)
    screen.add_trace(later._replace(now_ns=later.now_ns + 3_600 * SECOND_NS))
    screen.add_trace(trace_of_a_pulse(3))
    assert screen.heart_rate_per_min == pytest.approx(60 / BEAT_S, rel=0.02)


def test_a_pulse_that_is_not_felt_at_its_full_strength_has_no_heart_rate() -> None:
    screen = TerminalView()
    trace = trace_of_a_pulse(6)
    screen.add_trace(trace._replace(scored=trace.now_ns < 5_900_000_000))
    assert screen.heart_rate_per_min is None


def message_at(now_ns: int, felt_n: float = 0.356) -> bytes:
    """A trace message of one tick at full strength."""
    writer = TraceWriter()
    writer.add(TickState(now_ns=now_ns, felt_n=felt_n, scored=True))
    message = writer.rest()
    assert message is not None
    return message


def shown(context: Context, send: Callable[[zmq.Socket[bytes]], None]) -> str:
    """Return what a terminal shows of what `send` publishes, until a line names a state."""
    address, console = free_address(), Console(file=io.StringIO(), width=500)
    publisher = context.socket(zmq.XPUB)
    publisher.bind(address)
    end_s = time.monotonic() + 30.0
    subscriptions = 0

    def look() -> bool:
        nonlocal subscriptions
        while subscriptions < 2 and publisher.poll(10):
            publisher.recv()
            subscriptions += 1
            if subscriptions == 2:
                send(publisher)
        return ": " not in console.file.getvalue() and time.monotonic() < end_s

    watch(address, console, meanwhile=look)
    return console.file.getvalue()


PLAYING = pack_status("playing", "my pulse", Summary(finger="pressed with 356 mN"), final=False)


def test_telemetry_that_has_queued_is_as_old_as_it_is(context: Context) -> None:
    """A display had sent and frozen while its terminal was still importing: it was "playing"."""

    def send(publisher: zmq.Socket[bytes]) -> None:
        publisher.send_multipart((TRACE, message_at(time.monotonic_ns() - 5 * SECOND_NS)))
        publisher.send_multipart((STATUS, PLAYING))

    line = shown(context, send)
    assert line.startswith(("playing 5.", "playing 6.")), line
    assert "no telemetry: since" in line


def test_the_state_of_a_killed_display_is_not_made_current_by_the_next(context: Context) -> None:
    """The next process' first trace comes up to 0.2 s before its first status."""

    def send(publisher: zmq.Socket[bytes]) -> None:
        now_ns = time.monotonic_ns()
        publisher.send_multipart((TRACE, message_at(now_ns - 5 * SECOND_NS)))
        publisher.send_multipart((STATUS, PLAYING))
        publisher.send_multipart((TRACE, message_at(now_ns, 0.0)))

    assert shown(context, send).startswith(("playing 5.", "playing 6."))


def test_what_takes_long_to_import_is_there_before_the_first_line() -> None:
    """It took up to some seconds within a line, which showed a state that was over."""
    code = (
        "import sys; from rich.console import Console; from display_node.telemetry import terminal;"
        f" terminal.watch({free_address()!r}, Console(),"
        " meanwhile=lambda: print('scipy.signal' in sys.modules))"
    )
    command = [sys.executable, "-c", code]
    assert subprocess.run(command, capture_output=True, text=True, check=True).stdout == "True\n"


@given(
    st.text(max_size=200),
    st.lists(st.text(max_size=300), max_size=4),
    st.text(max_size=300),
    st.floats(allow_infinity=False),
    st.integers(0, 1 << 53),
)
def test_a_status_line_has_at_most_120_characters(
    state: str, faults: list[str], finger: str, force_n: float, count: int
) -> None:
    screen, ticks = TerminalView(), np.arange(2) * 10_000_000
    force = np.full(2, force_n)
    screen.add_trace(Trace(ticks, ticks, force, force, np.ones(2, bool)))
    counts = SampleCounts(count, count, count, count, count)
    summary = Summary(samples=counts, faults=faults, finger=finger).to_dict()
    screen.status = Status(state, "stream", summary, False)
    for now_ns in (0, 10**17):
        assert len(screen.line(now_ns)) <= 120
        assert "\n" not in screen.line(now_ns)
