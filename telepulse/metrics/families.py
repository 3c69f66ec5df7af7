"""A node's last status as Prometheus's metrics. Pure: time comes in."""

import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from importlib.metadata import version
from typing import Any

from prometheus_client.metrics_core import (
    GaugeMetricFamily,
    InfoMetricFamily,
    Metric,
    StateSetMetricFamily,
)

from protocol.figures import COUNT, Figure, Surface
from protocol.run_summary import REGISTRY
from protocol.wire.status import Status

PREFIX = "telepulse_"
# As long as a node may be held up and still be there.
SILENT_AFTER_NS = 5_000_000_000
STATES = ("waiting", "starting", "playing", "stale", "ended", "fault", "streaming")
_NUMBER = re.compile(r"\d+(\.\d+)?")


@dataclass(frozen=True, slots=True)
class NodeState:
    """sent_ns: when the node sent it, as far as is known, on this process's clock."""

    status: Status
    sent_ns: int
    heart_rate_per_min: float | None = None


def families(
    program: str, told: NodeState | None, now_ns: int, unreadable: int = 0
) -> Iterator[Metric]:
    """The metrics at `now_ns`. A node that is silent has no figures, only the age of the last."""
    silent = told is None or now_ns - told.sent_ns > SILENT_AFTER_NS
    yield _gauge("up", "Whether the node speaks: 0 after 5 s of silence.", not silent)
    misread = Metric(PREFIX + "unreadable_statuses", "Statuses that could not be read.", "counter")
    misread.add_sample(misread.name + "_total", {}, unreadable)
    yield misread
    if told is None:
        return
    age_s = (now_ns - told.sent_ns) * 1e-9
    yield _gauge("status_age_seconds", "How old the figures are.", age_s)
    yield _info(program, told.status)
    if silent:
        return
    yield _state(told.status.state)
    if told.heart_rate_per_min is not None and told.status.state == "playing":
        yield _gauge("heart_rate_hertz", "Of the pulse that is felt.", told.heart_rate_per_min / 60)
    if told.status.displays is not None:
        yield _gauge("displays", "Displays that listen.", told.status.displays)
    yield from _figures(told.status.summary)


def _gauge(name: str, text: str, value: float) -> Metric:
    return GaugeMetricFamily(PREFIX + name, text, value=value)


def _info(program: str, status: Status) -> Metric:
    words = {"program": program, "version": version("telepulse"), "stream": status.stream}
    # As text: a number of 63 bits is none of Prometheus's.
    words["session"] = "" if status.session is None else f"{status.session:x}"
    return InfoMetricFamily(PREFIX + "node", "Who this is, and its stream.", words)


def _state(state: str) -> Metric:
    known = {name: name == state for name in (*STATES, state)}
    return StateSetMetricFamily(PREFIX + "state", "What the node does, in one word.", known)


def _figures(summary: Mapping[str, Any]) -> Iterator[Metric]:
    """Yield the figures that have a value; those of one name together, under the first's help."""
    found: dict[str, Metric] = {}
    help_texts: dict[str, str] = {}
    for figure in REGISTRY.on(Surface.METRICS):
        help_text = help_texts.setdefault(figure.metric, figure.help or figure.meaning)
        for labels, value in _samples(figure, summary):
            name = PREFIX + figure.metric
            metric = found.setdefault(name, Metric(name, help_text, figure.kind))
            metric.add_sample(name + ("_total" if figure.counter else ""), labels, value)
    yield from found.values()


def _samples(figure: Figure, summary: Mapping[str, Any]) -> Iterator[tuple[dict[str, str], float]]:
    value = figure.value(summary)
    if isinstance(value, dict):
        for name, count in value.items():
            yield {figure.label: name}, count
    elif isinstance(value, str):
        yield from _texts(figure.label, [value] if value else [])
    elif isinstance(value, list):
        yield from _texts(figure.label, value)
    elif value is not None:
        yield dict(figure.labels), value * (figure.unit or COUNT).base


def _texts(label: str, values: Iterable[str]) -> Iterator[tuple[dict[str, str], float]]:
    """Yield texts as labels. Their numbers, each a label of its own, stay in the summary."""
    for text in sorted({_NUMBER.sub("#", value) for value in values}):
        yield {label: text}, 1
