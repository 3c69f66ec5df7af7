import json
from pathlib import Path

import pytest

from telepulse.recording.contents import RecordingContents
from telepulse.recording.findings import RunFindings, read_findings
from telepulse.recording.mcap_reader import RecordingReader, in_tick_order
from telepulse.telemetry.schema import TICK
from tests.support.nodes import RADIAL, free_address, process, read_json, run
from tests.support.recordings import DELAY_TICKS, GAIN, record
from tests.system.recording.test_replay_command import recorded_display

MODULE = "telepulse"
PATIENCE_S = 240.0


@pytest.mark.timeout(2 * PATIENCE_S)
def test_the_figures_are_the_displays_own(path: Path) -> None:
    address = free_address()
    sensing = ("sensing_node.cli", str(RADIAL), "--bind", address, "--seconds", "5", "--quiet")
    with recorded_display(path, address) as display, process(*sensing):
        display.communicate(timeout=PATIENCE_S)
        assert display.returncode == 0
    own = read_json(path.with_suffix(".json"))
    made = own.pop("provenance")
    findings = read_findings(path)
    found = findings.summary().to_dict()
    assert findings.contents.summary is not None
    assert findings.contents.final
    assert own["windows"]
    assert findings.contents.summary.to_dict() == own
    assert findings.contents.provenance[0]["version"] == made["version"]
    assert own["beats"]["count"] >= 1
    for part in ("frames", "one_way_delay_ms", "clock", "beats"):
        assert found[part] == own[part], part
    assert found["loop"]["ticks"] == own["loop"]["ticks"]
    # Ticks missed before the first one are not in the recording.
    assert found["loop"]["deadline_misses"] <= own["loop"]["deadline_misses"]
    assert found["samples"]["sent"] == own["samples"]["sent"]
    assert found["samples"]["lost"] == own["samples"]["lost"]
    assert found["force_rmse_n"] == pytest.approx(own["force_rmse_n"], rel=0.01)
    assert own["strain_rmse"]["aligned"] > 0
    assert found["strain_rmse"] == pytest.approx(own["strain_rmse"], rel=0.01)
    assert found["within_jnd"] == pytest.approx(own["within_jnd"], abs=0.01)
    means_ms = [each["playout_delay_ms"]["mean"] for each in (found, own)]
    assert means_ms[0] == pytest.approx(means_ms[1], abs=1)


@pytest.mark.timeout(2 * PATIENCE_S)
def test_the_command_writes_page_and_tables(path: Path, tmp_path: Path) -> None:
    tables = tmp_path / "tables.json"
    record(path, 8)
    arguments = ("report", str(path), "--json", str(tables))
    result = run(MODULE, *arguments, timeout_s=PATIENCE_S)
    assert (result.returncode, result.stderr) == (0, "")
    folder = tmp_path / "a-report"
    assert f"report: {folder / 'index.html'}" in result.stdout
    assert (folder / "index.html").exists()
    chapters = json.loads(tables.read_text(encoding="utf-8"))["chapters"]
    rows = {row["figure"]: row["recorded span"] for row in chapters[0]["tables"][0]["rows"]}
    assert rows["loop, ticks"] == "8000"
    assert rows["playout delay, mean"] == f"{DELAY_TICKS:.2f} ms"


def test_it_finds_what_is_known_to_be_in_a_recording(path: Path) -> None:
    record(path, 20, {1_000, *range(2_000, 2_100)})
    findings = read_findings(path)
    found = findings.summary()
    assert (findings.ticks, found.loop.deadline_misses) == (20_000, 0)
    assert found.samples.lost == 505
    assert found.one_way_delay_ms.max == pytest.approx(1.0)
    assert found.playout_delay_ms.mean == pytest.approx(DELAY_TICKS)
    assert found.force_rmse_n.aligned == pytest.approx((GAIN - 1) * 0.3, rel=0.3)
    assert found.within_jnd == 1.0
    felt = [round(felt or 0) for _, _, felt in findings.contactors[0].heart]
    assert felt == pytest.approx([75] * 3, abs=4)
    # Nothing was sensed for half a second: no heart rate of the wrist then.
    assert [wrist is None for _, wrist, _ in findings.contactors[0].heart] == [
        False,
        True,
        False,
    ]
    names = [event.name for event in findings.events]
    assert names == ["begin", "session", "state", "join", "state", "end"]


def test_ticks_that_were_left_out_are_missed_ones(path: Path) -> None:
    record(path, 2)
    contents = RecordingContents()
    for number, entry in enumerate(in_tick_order(RecordingReader(path))):
        if entry.topic != TICK or number % 100:
            contents.take(entry)
    findings = RunFindings(contents)
    assert findings.ticks + findings.summary().loop.deadline_misses == 2_000
    assert findings.ticks < 1_990
