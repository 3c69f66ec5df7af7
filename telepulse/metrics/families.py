"""A node's last status as Prometheus's metrics. Pure: time comes in."""

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from importlib.metadata import version
from typing import Any

from prometheus_client.metrics_core import (
    GaugeMetricFamily,
    InfoMetricFamily,
    Metric,
    StateSetMetricFamily,
)

from protocol.wire.status import Status
from telepulse.metrics.figures import FIGURES, MetricFigure

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
    yield _texts("fault", "Faults and what sensors missed, 1 each.", told.status.summary["faults"])
    if finger := told.status.summary["finger"]:
        yield _texts("finger", "What is measured at the finger, 1.", [finger])
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


def _texts(name: str, text: str, values: list[str]) -> Metric:
    """Return texts as labels. Their numbers, each a label of its own, stay in the summary."""
    family = GaugeMetricFamily(PREFIX + name, text, labels=["name"])
    for name in sorted({_NUMBER.sub("#", value) for value in values}):
        family.add_metric([name], 1)
    return family


def _figures(summary: Mapping[str, Any]) -> Iterator[Metric]:
    """The figures that there are, those of one name together."""
    found: dict[str, Metric] = {}
    for figure in FIGURES:
        samples = list(_samples(figure, summary))
        if not samples and figure.name not in found:
            continue
        name = PREFIX + figure.name
        if figure.name not in found:
            text = figure.help or next(f.help for f in FIGURES if f.name == figure.name)
            found[figure.name] = Metric(name, text, figure.kind.value)
        for labels, value in samples:
            suffix = "_total" if figure.kind is figure.kind.COUNTER else ""
            found[figure.name].add_sample(name + suffix, labels, value)
    yield from found.values()


def _samples(
    figure: MetricFigure, summary: Mapping[str, Any]
) -> Iterator[tuple[dict[str, str], float]]:
    value: Any = summary
    for key in figure.key.split("."):
        value = value[key]
    if figure.label:
        for name, count in value.items():
            yield {figure.label: name}, count
    elif value is not None:
        yield dict(figure.labels), value * figure.scale
