"""The configuration and the rules of docs/monitoring, for Prometheus."""

import re
import shutil
import subprocess

import pytest

from protocol.wire.telemetry import Status
from telepulse.metrics.server import NodeState, families
from tests.support.full_summary import full_summary
from tests.support.nodes import ROOT

MONITORING = ROOT / "docs" / "monitoring"


@pytest.mark.skipif(shutil.which("promtool") is None, reason="needs promtool (Debian: prometheus)")
@pytest.mark.parametrize("name", ["prometheus.yml", "compose/prometheus.yml"])
def test_the_configuration_and_the_rules_are_valid(name: str) -> None:
    command = ["promtool", "check", "config", str(MONITORING / name)]
    ended = subprocess.run(command, capture_output=True, encoding="utf-8", check=False)
    assert ended.returncode == 0, ended.stdout + ended.stderr
    assert "8 rules found" in ended.stdout


def test_the_rules_name_metrics_that_a_display_has() -> None:
    node = NodeState(Status("playing", "", full_summary().to_dict(), False), 0)
    there = {one.name for family in families("display-node", node, 0) for one in family.samples}
    rules = (MONITORING / "telepulse.rules.yml").read_text(encoding="utf-8")
    named = set(re.findall(r"telepulse_\w+", rules))
    assert len(named) > 5
    assert named <= there
