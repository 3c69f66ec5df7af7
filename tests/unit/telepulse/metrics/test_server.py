"""Metrics read back by Prometheus's own parser."""

import threading
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import replace
from http.client import HTTPConnection, HTTPException
from urllib.parse import urlsplit

import pytest
from hypothesis import given
from hypothesis import strategies as st
from prometheus_client import CollectorRegistry, generate_latest
from prometheus_client.metrics_core import Metric
from prometheus_client.parser import text_string_to_metric_families
from prometheus_client.registry import Collector

from protocol.errors import AddressError
from protocol.faults import Fault, FaultKind, Note, Part
from protocol.finger import FingerState, WithdrawalOutcome
from protocol.summary.fields import (
    BeatFigures,
    Clock,
    Compensation,
    FrameCounts,
    Lateness,
    Limited,
    Limits,
    Loop,
    OneWayDelay,
    RmsErrors,
    SampleCounts,
    Summary,
)
from protocol.wire.telemetry import Status
from telepulse.metrics.server import (
    MAX_REQUESTS,
    SILENT_AFTER_NS,
    MetricsServer,
    NodeState,
    families,
    parse_address,
)

SECOND_NS = 1_000_000_000
Scraped = dict[tuple[str, tuple[tuple[str, str], ...]], float]


class Page(Collector):
    def __init__(self, metrics: list[Metric]) -> None:
        self._metrics = metrics

    def collect(self) -> Iterator[Metric]:
        yield from self._metrics


def scraped(metrics: Iterator[Metric]) -> Scraped:
    """Return the samples of a scrape: each once, by its name and labels."""
    registry = CollectorRegistry()
    registry.register(Page(list(metrics)))
    found: Scraped = {}
    for family in text_string_to_metric_families(generate_latest(registry).decode()):
        for sample in family.samples:
            key = sample.name, tuple(sorted(sample.labels.items()))
            assert key not in found
            found[key] = sample.value
    return found


def node_state(summary: Summary, state: str = "playing", stream: str = "my pulse") -> NodeState:
    status = Status(state, stream, summary.to_dict(), False, session=0xABC)
    return NodeState(status, sent_ns=SECOND_NS, heart_rates_per_min=[75.0, 90.0])


def test_figures_come_in_base_units_and_counts_as_counters() -> None:
    summary = Summary(
        samples=SampleCounts(1000, 890, 100, 7, 3, 50),
        frames=FrameCounts(200, 1, 0, {"tcp://a:1": 120, "tcp://b:1": 80}),
        one_way_delay_ms=OneWayDelay(1.5, 4.0, 9.0),
        clock=Clock(offset_ms=-2.0, skew_ppm=30.0),
        loop=Loop(5000, 4, late_us=Lateness(60.0, 100.0, 500.0, 900.0)),
        rejected={"late_hello": 2},
        faults=[Fault(FaultKind.SILENT, Part.FILM, "silent for 40 ms", 7, "cun")],
        notes=[Note(Part.FILM, "17 samples missing from /dev/ttyACM0", "cun")],
        finger=FingerState(0.245, 0.01, "", WithdrawalOutcome.UNCONFIRMED, False),
    )
    found = scraped(families("display-node", node_state(summary), 3 * SECOND_NS))
    for name, labels, value in [
        ("status_age_seconds", {}, 2),
        ("samples_total", {"outcome": "played"}, 890),
        ("frames_first_total", {"path": "tcp://b:1"}, 80),
        ("one_way_delay_seconds", {"quantile": "0.99"}, 0.004),
        ("one_way_delay_max_seconds", {}, 0.009),
        ("clock_offset_seconds", {}, -0.002),
        ("clock_skew_ratio", {}, 30e-6),
        ("deadline_misses_total", {}, 4),
        ("tick_lateness_seconds", {"quantile": "0.999"}, 500e-6),
        ("rejected_total", {"cause": "late_hello"}, 2),
        ("heart_rate_hertz", {}, 1.25),
        ("state", {"telepulse_state": "playing"}, 1),
        ("state", {"telepulse_state": "stale"}, 0),
        ("finger_newtons", {}, 0.245),
        ("withdrawal", {"state": "unconfirmed"}, 1),
        ("drive_answers", {}, 0),
        ("fault", {"kind": "silent", "part": "film", "contactor": "cun"}, 1),
        (
            "note",
            {"part": "film", "contactor": "cun", "text": "# samples missing from /dev/ttyACM#"},
            1,
        ),
    ]:
        got = found["telepulse_" + name, tuple(sorted(labels.items()))]
        assert abs(got - value) < 1e-12, name
    (labels,) = (dict(labels) for name, labels in found if name == "telepulse_node_info")
    assert labels["program"] == "display-node"
    assert (labels["stream"], labels["session"]) == ("my pulse", "abc")


def test_a_strain_is_not_explained_as_a_force() -> None:
    errors = Summary(force_rmse_n=RmsErrors(2e-3, 3e-3), strain_rmse=RmsErrors(1e-8, 2e-8))
    helps = {
        family.name: family.documentation
        for family in families("display-node", node_state(errors), SECOND_NS)
    }
    assert helps["telepulse_force_rmse_newtons"] == "RMSE of the felt force against the pulse."
    assert helps["telepulse_strain_rmse_ratio"] == "RMSE of the felt strain against the pulse."


def test_the_figures_of_several_contactors_have_their_names_as_labels() -> None:
    cun = Summary(
        beats=BeatFigures(count=7, rate_per_min=75.0),
        compensation=Compensation(error_n=0.002, corrections=3),
        limited=Limits(force=Limited(2, 0.5, 0.05)),
        finger=FingerState(0.245),
    )
    chi = Summary(beats=BeatFigures(count=8, alarm=True), hardware={"garbled": 3})
    compensation = Compensation(predicted=0.25)
    several = Summary(compensation=compensation, contactors={"cun": cun, 'c"hi': chi})
    found = scraped(families("display-node", node_state(several), SECOND_NS))
    only = scraped(
        families("display-node", node_state(replace(cun, compensation=compensation)), SECOND_NS)
    )
    for name, labels, value in [
        ("beats_total", {"contactor": "cun"}, 7),
        ("pulse_alarm", {"contactor": 'c"hi'}, 1),
        ("heart_rate_hertz", {"contactor": "cun"}, 1.25),
        ("limited_total", {"contactor": "cun", "limit": "force"}, 2),
        ("hardware_events_total", {"contactor": 'c"hi', "event": "garbled"}, 3),
        ("finger_newtons", {"contactor": "cun"}, 0.245),
    ]:
        assert found["telepulse_" + name, tuple(sorted(labels.items()))] == value, name
    # Those of the display have no contactor, nor has any figure of an only one.
    assert found.keys() >= {key for key in only if "predicted" in key[0]}
    assert not any("contactor" in dict(labels) for _, labels in only)


def test_a_node_that_is_silent_has_no_figures_and_is_not_up_nor_before_its_first_status() -> None:
    found = scraped(families("display-node", None, 0, unreadable=3))
    assert found["telepulse_up", ()] == 0
    assert found["telepulse_unreadable_statuses_total", ()] == 3
    summary = Summary(samples=SampleCounts(1000, 890, 100, 7, 3, 0))
    last_ns = SECOND_NS + SILENT_AFTER_NS
    alive = scraped(families("display-node", node_state(summary), last_ns))
    silent = scraped(families("display-node", node_state(summary), last_ns + 1))
    assert alive["telepulse_up", ()] == 1
    assert ("telepulse_samples_sent_total", ()) in alive
    assert silent["telepulse_up", ()] == 0
    assert silent["telepulse_status_age_seconds", ()] > 5
    assert {name for name, _ in silent} == {
        "telepulse_up",
        "telepulse_status_age_seconds",
        "telepulse_node_info",
        "telepulse_unreadable_statuses_total",
    }


def test_where_metrics_are_served() -> None:
    assert [parse_address(text) for text in ("9100", "0", "[::1]:9100", "localhost:9100")] == [
        ("127.0.0.1", 9100),
        ("127.0.0.1", 0),
        ("::1", 9100),
        ("localhost", 9100),
    ]


@given(st.text() | st.integers().map(str) | st.integers().map("host:{}".format))
def test_an_address_is_one_or_refused(text: str) -> None:
    try:
        host, port = parse_address(text)
    except AddressError:
        return
    assert host
    assert 0 <= port <= 65_535


def test_after_a_shortage_of_threads_requests_are_served_again(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    place = urlsplit(MetricsServer("display-node", "127.0.0.1", 0).url)

    def status() -> int:
        connection = HTTPConnection(place.netloc, timeout=20)
        try:
            connection.request("GET", place.path)
            return connection.getresponse().status
        finally:
            connection.close()

    def fail(thread: threading.Thread) -> None:
        raise RuntimeError("can't start new thread")

    assert status() == 200
    with monkeypatch.context() as patched:
        patched.setattr(threading.Thread, "start", fail)
        for _ in range(MAX_REQUESTS + 2):
            with suppress(HTTPException, OSError):
                status()
    assert status() == 200
