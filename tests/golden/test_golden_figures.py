"""The summary's JSON keys, the metrics and the schemas of recordings are those that others read.

`python -m tests.golden.test_golden_figures` writes the golden copy anew, after a deliberate change.
"""

import json
from pathlib import Path
from typing import Any

from protocol.wire.telemetry import Status
from telepulse.metrics.server import NodeState, families
from telepulse.telemetry.schema import SCHEMAS
from tests.support.full_summary import full_summary

GOLDEN = Path(__file__).with_name("figures.json")


def present() -> dict[str, Any]:
    """Return the summary's keys with values, what Prometheus gets of them, and the schemas."""
    summary = full_summary().to_dict()
    node = NodeState(Status("playing", "a stream", summary, False, 1), 0, 75.0)
    metrics = {
        f"{sample.name} {json.dumps(sample.labels, sort_keys=True)}": [metric.type, sample.value]
        for metric in families("display-node", node, 0)
        for sample in metric.samples
        if metric.name != "telepulse_node"
    }
    return {"summary": summary, "metrics": dict(sorted(metrics.items())), "schemas": SCHEMAS}


def test_keys_metrics_and_schemas_are_the_same_as_before() -> None:
    golden = json.loads(GOLDEN.read_text(encoding="utf-8"))
    now = json.loads(json.dumps(present()))
    assert now == golden
    assert list(now["summary"]) == list(golden["summary"])


if __name__ == "__main__":
    GOLDEN.write_text(json.dumps(present(), indent=1, ensure_ascii=False) + "\n", encoding="utf-8")
