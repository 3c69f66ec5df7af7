"""Metrics of a node's last status, in Prometheus's names and base units. Pure."""

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
from protocol.wire.telemetry import Status

PREFIX = "telepulse_"
# A node may be held up for that long.
SILENT_AFTER_NS = 5_000_000_000
STATES = ("waiting", "starting", "playing", "stale", "ended", "fault", "streaming")
_NUMBER = re.compile(r"\d+(\.\d+)?")


@dataclass(frozen=True, slots=True)
class NodeState:
    """Last status of a node; sent_ns: when the node sent it, on this process's clock."""

    status: Status
    sent_ns: int
    heart_rate_per_min: float | None = None


def families(
    program: str, node: NodeState | None, now_ns: int, unreadable: int = 0
) -> Iterator[Metric]:
    """Yield the metrics at `now_ns`; of a silent node only the age of its last status."""
    silent = node is None or now_ns - node.sent_ns > SILENT_AFTER_NS
    yield _gauge("up", "1: the node sends statuses; 0: silent for 5 s.", not silent)
    misread = Metric(PREFIX + "unreadable_statuses", "Statuses that could not be read.", "counter")
    misread.add_sample(misread.name + "_total", {}, unreadable)
    yield misread
    if node is None:
        return
    age_s = (now_ns - node.sent_ns) * 1e-9
    yield _gauge("status_age_seconds", "Age of the figures.", age_s)
    yield _info(program, node.status)
    if silent:
        return
    yield _state(node.status.state)
    if node.heart_rate_per_min is not None and node.status.state == "playing":
        yield _gauge(
            "heart_rate_hertz",
            "Heart rate of the pulse that is felt.",
            node.heart_rate_per_min / 60,
        )
    if node.status.displays is not None:
        yield _gauge("displays", "Displays that are connected.", node.status.displays)
    yield from _figures(node.status.summary)


def _gauge(name: str, text: str, value: float) -> Metric:
    return GaugeMetricFamily(PREFIX + name, text, value=value)


def _info(program: str, status: Status) -> Metric:
    words = {"program": program, "version": version("telepulse"), "stream": status.stream}
    # As text: a number of 63 bits is none of Prometheus's.
    words["session"] = "" if status.session is None else f"{status.session:x}"
    return InfoMetricFamily(PREFIX + "node", "The node and its stream.", words)


def _state(state: str) -> Metric:
    known = {name: name == state for name in (*STATES, state)}
    return StateSetMetricFamily(PREFIX + "state", "State of the node.", known)


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
