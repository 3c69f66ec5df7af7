"""Real nodes, one short episode, over links between namespaces; needs root."""

import asyncio
import json
import os
from pathlib import Path

import pytest

import soak.run
from soak.evidence import verdict
from soak.leftovers import MARK, left_behind
from soak.network import namespaces
from soak.report import write_verdict
from soak.run import Run
from soak.scenario import Scenario
from soak.schedule import RESTARTED, SENSING, Episode, Fault
from soak.verdict import judge_none
from telepulse.scene import load_scene
from tests.support.keyring import Keyring
from tests.support.log_lines import refused
from tests.support.nodes import RADIAL
from tests.support.tcp import needs_emulator

EPISODE = Episode(
    (Fault("kill sensing", SENSING, 0.0, 0.2), Fault("freeze display", RESTARTED, 0.1, 0.3)), 2.0
)

OPTIONS = ("--realtime", "slack")


@pytest.fixture
def short(monkeypatch: pytest.MonkeyPatch) -> None:
    """Make the run one episode, as soon as may be."""
    monkeypatch.setattr(soak.run, "episodes", lambda seed: iter([EPISODE]))
    monkeypatch.setattr(soak.run, "HEAD_START_S", 2.0)
    monkeypatch.setenv(MARK, str(os.getpid()))


@needs_emulator
@pytest.mark.usefixtures("short")
def test_a_soak_finds_every_sample_and_leaves_nothing_behind(tmp_path: Path) -> None:
    folder = tmp_path / "soak"
    folder.mkdir()
    scene = load_scene(RADIAL)
    with namespaces(seed=1) as network:
        keys = Keyring(tmp_path / "keys")
        keys.allow("finger", "monitor")
        scenario = Scenario(network, RADIAL, folder, longest_s=60.0, keys=keys, options=OPTIONS)
        under_test = Run(scenario, 1, 60.0, scene.display.tick_ns, print)
        try:
            asyncio.run(under_test.play())
        finally:
            scenario.clear()
        checks = {check.name: check for check in verdict(under_test, scene.display, 75.0)}
    left = left_behind(under_test.namespaces, [scenario.calm_address], str(folder))
    assert left == [f"the folder {folder}"]

    # What a busy machine cannot change.
    for name in ("bad ends", "clock steps", "faults latched", "account of calm display"):
        assert checks[name].ok, checks[name]
    # Nothing that was claimed is untrue, and something was claimed of each kind.
    for role in ("calm display", "continuous", "restarted"):
        for claim in ("state", "finger", "figures", "availability"):
            assert checks[f"{claim} of {role}"].ok, checks[f"{claim} of {role}"]
        assert checks[f"terminal of {role}: state and force"].ok is not None
    assert checks["exit statuses and summaries"].ok
    for role in ("continuous", "restarted"):
        account = checks[f"account of {role}"]
        assert account.ok, account
        assert not account.found.startswith("0 samples")
        assert checks[f"force of {role}"].ok
    assert "felt again: freeze display + kill sensing" in checks
    printed = [path.read_text("utf-8") for path in folder.glob("*.err")]
    assert sum("real-time: slack" in text for text in printed) == len(scenario.all_nodes)
    nodes = [(node.role, node.ending) for node in scenario.all_nodes if node.role == "sensing"]
    assert nodes == [("sensing", "killed"), ("sensing", "stopped")]

    result = tmp_path / "soak.json"
    write_verdict(under_test, [*checks.values(), judge_none("zombies", ["one"])], 1.0, result)
    table = json.loads(result.read_text(encoding="utf-8"))
    assert table["passed"] is False
    assert table["episodes"][0]["longest_gap_s"]["restarted"] > 0.2
    assert len(table["processes"]) == 6


def test_a_result_that_cannot_be_written_is_one_line_before_the_run(tmp_path: Path) -> None:
    assert refused("soak", "--json", str(tmp_path / "no" / "soak.json"))
