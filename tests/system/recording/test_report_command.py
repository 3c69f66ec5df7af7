import json
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest

from protocol.summary.tables import Availability, Limited, Limits, Loop, PlayoutDelay
from protocol.wire.telemetry import CONTROL
from telepulse.recording.findings import RunFindings, read_findings
from telepulse.recording.mcap_writer import McapWriter
from telepulse.recording.reader import RecordingReader, in_tick_order
from telepulse.recording.report import build_recording_report
from telepulse.recording.signal_export import recording_signals
from telepulse.telemetry.schema import TICK
from tests.support.nodes import RADIAL, ROOT, free_address, process, read_json, run
from tests.support.recordings import DELAY_TICKS, GAIN, record
from tests.support.telemetry_publisher import WELCOME, HandmadeTelemetry
from tests.system.recording.test_replay_command import recorded_display

MODULE = "telepulse"
PATIENCE_S = 240.0
PLOTS = (
    *("force-first", "force-worst", "error", "heart-rate", "beats"),
    *("delays", "delay-distribution", "loss", "clock", "loop"),
)


class Page(HTMLParser):
    """Parser that finds the files that a page needs."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.needed: set[str] = set()
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        found = {value for name, value in attrs if name in ("src", "srcset", "href")}
        self.needed |= {value for value in found if not str(value).startswith("#")}


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
    assert findings.display_summary is not None
    assert findings.is_final_summary
    # The windows are computed after the last status.
    assert own["windows"]
    assert findings.display_summary.to_dict() == own | {"windows": []}
    assert findings.provenance[0]["version"] == made["version"]
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
def test_each_contactor_has_its_figures_and_chapters(path: Path) -> None:
    scene, address = str(ROOT / "scenes" / "three_fingers.toml"), free_address()
    sensing = ("sensing_node.cli", scene, "--bind", address, "--seconds", "8", "--quiet")
    with recorded_display(path, address, scene) as display, process(*sensing):
        display.communicate(timeout=PATIENCE_S)
        assert display.returncode == 0
    own = read_json(path.with_suffix(".json"))["contactors"]
    found = read_findings(path).summary().to_dict()["contactors"]
    assert tuple(found) == tuple(own) == ("cun", "guan", "chi")
    for name, figures in found.items():
        assert figures["beats"] == own[name]["beats"]
        assert figures["force_rmse_n"] == pytest.approx(own[name]["force_rmse_n"], rel=0.01)
    report = build_recording_report(path)
    titles = [chapter.title for chapter in report.chapters]
    assert [f"Force – {name}" in titles for name in own] == [True] * 3
    names = [plot.name for chapter in report.chapters for plot in chapter.plots]
    assert len(names) == len(set(names))
    rows = {row[0]: row[1:] for row in report.chapters[0].tables[0].rows}
    recorded, displayed = rows["guan: pulse, height"]
    assert recorded == displayed
    assert float(recorded.removesuffix(" mN")) == pytest.approx(300, rel=0.05)


@pytest.mark.timeout(2 * PATIENCE_S)
def test_a_recorded_press_has_a_chapter_on_press_hold_down_and_height(path: Path) -> None:
    scene, address = str(ROOT / "scenes" / "press.toml"), free_address()
    sensing = ("sensing_node.cli", scene, "--bind", address, "--seconds", "12", "--quiet")
    with recorded_display(path, address, scene) as display, process(*sensing):
        display.communicate(timeout=PATIENCE_S)
        assert display.returncode == 0
    findings = read_findings(path)
    # One value a tick of the finger's press, and one a frame of the wrist's hold-down.
    for name in ("press_n", "wrist_hold_down_n"):
        points = findings.trends[name].points()
        assert 1.0 < points.high.max() < 1.5
        assert np.diff(points.t_s).min() < 0.3
    (chapter,) = [c for c in build_recording_report(path).chapters if "hold-down" in c.title]
    assert chapter.plots[0].name == "press"
    # The curve needs more beats than a short run has: `test_pressed_beats.py` draws it.
    assert "hold-down" in chapter.paragraphs[0]
    ticks = [entry.fields for entry in RecordingReader(path) if entry.topic == TICK]
    assert all("press_n" in fields for fields in ticks)
    assert sum("hold_down_n" in fields for fields in ticks) > len(ticks) / 2
    table, _ = recording_signals(path)
    assert "Press" in table.names
    assert 0.5e3 < np.nanmax(table.values[:, table.names.index("Press")]) < 1.5e3


@pytest.mark.timeout(2 * PATIENCE_S)
def test_the_page_has_all_it_shows_beside_it(path: Path, tmp_path: Path) -> None:
    tables = tmp_path / "tables.json"
    record(path, 8)
    arguments = ("report", str(path), "--json", str(tables))
    result = run(MODULE, *arguments, timeout_s=PATIENCE_S)
    assert (result.returncode, result.stderr) == (0, "")
    folder = tmp_path / "a-report"
    assert f"report: {folder / 'index.html'}" in result.stdout
    needed = Page((folder / "index.html").read_text(encoding="utf-8")).needed
    assert {f"{name}.svg" for name in PLOTS} == needed
    for name in needed:
        assert (folder / name).stat().st_size > 1_000
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
    felt = [round(felt or 0) for _, _, felt in findings.contactors[0].forces.heart]
    assert felt == pytest.approx([75] * 3, abs=4)
    # Nothing was sensed for half a second: no heart rate of the wrist then.
    assert [wrist is None for _, wrist, _ in findings.contactors[0].forces.heart] == [
        False,
        True,
        False,
    ]
    names = [event.name for event in findings.events]
    assert names == ["begin", "session", "state", "join", "state", "end"]


def test_a_recording_that_was_never_played_is_reported(path: Path) -> None:
    record(path, 1)
    force = build_recording_report(path).chapters[1]
    assert force.paragraphs == ("The pulse was never played at its full strength.",)
    assert force.plots == ()


def test_where_no_heart_rate_was_found_none_is_plotted(
    path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # As on a busy host, where each window of six seconds has a gap.
    monkeypatch.setattr("telepulse.recording.forces.MAX_GAP_S", 0.0)
    record(path, 12)
    force = build_recording_report(path).chapters[1]
    assert [plot.name for plot in force.plots] == ["force-first", "force-worst", "error"]


def test_a_limit_that_was_reached_is_an_event_and_a_row(path: Path) -> None:
    telemetry = HandmadeTelemetry()
    writer = McapWriter(path)
    limited = Limits(force=Limited(312, 4.1, 0.205))
    for entry in [
        *telemetry.receive((CONTROL, WELCOME)),
        *telemetry.status("playing"),
        *telemetry.status("playing", limited=limited),
        *telemetry.status("playing", limited=limited, final=True),
    ]:
        writer.add(entry)
    assert writer.close() is None
    findings = read_findings(path)
    assert findings.display_summary is not None
    assert findings.display_summary.limited == limited
    named = [(event.name, event.text) for event in findings.events]
    assert named.count(("limited", "force limit reached")) == 1
    rows = {row[0]: row[2] for row in build_recording_report(path).chapters[0].tables[0].rows}
    assert rows["at a limit"] == "force limit 312 times, 4.1 s (20.5 % of the run)"


def test_each_column_names_its_span(path: Path) -> None:
    whole_run = {
        "availability": Availability(21.3, 1.0),
        "loop": Loop(21_300, 0),
        "playout_delay_ms": PlayoutDelay(mean=-0.001),
    }
    record(path, 3, whole_run=whole_run)
    report = build_recording_report(path)
    table = report.chapters[0].tables[0]
    assert table.columns == ("figure", "recorded span", "whole run (display)")
    spans = (
        "“recorded span” is 3.0 s of ticks, computed from the recorded messages; “whole run"
        " (display)” is 21.3 s, counted by the display from its start, 18300 ticks more than were"
        " recorded."
    )
    assert table.note.startswith(spans)
    assert spans in report.chapters[0].paragraphs
    rows = {row[0]: row[1:] for row in table.rows}
    assert rows["playout delay, mean"] == (f"{DELAY_TICKS:.2f} ms", "0.00 ms")
    assert [s for s in report.findings if "whole run of 21.3 s" in s] == report.findings[-1:]
    assert "3.0 s that were recorded" in report.findings[0]


def test_marks_are_in_the_plots_over_time_in_the_table_and_in_the_findings(path: Path) -> None:
    from matplotlib.figure import Figure

    record(path, 12, marks={9_000: "cuff off", 4_000: "cuff on"})
    report = build_recording_report(path)
    (events,) = [
        table for each in report.chapters for table in each.tables if table.title == "Events"
    ]
    assert events.columns == ("time (s)", "level", "event", "text")
    times_s = [float(row[0]) for row in events.rows]
    assert times_s == sorted(times_s)
    marks = {row[3]: row[1:3] for row in events.rows if row[2] == "mark"}
    assert marks == {"cuff on": ("info", "mark"), "cuff off": ("info", "mark")}
    assert len(report.findings) <= 5
    assert report.findings[0].startswith("A pulse was felt for ")
    assert any(each.endswith("Marks: 2.") for each in report.findings)
    assert any("ticks were missed" in each for each in report.findings)
    plots = {plot.name: plot for chapter in report.chapters for plot in chapter.plots}
    for name in ("error", "heart-rate", "beats", "delays", "loss", "clock", "loop"):
        figure = Figure()
        plots[name].draw(figure)
        lines = [line for axes in figure.axes for line in axes.lines if line.get_linestyle() == ":"]
        at_s = {round(float(np.ravel(line.get_xdata())[0])) for line in lines}
        assert at_s
        assert at_s <= {4, 9}, name
        assert "marks are dotted" in plots[name].caption
    assert "dotted" not in plots["delay-distribution"].caption


def test_ticks_that_were_left_out_are_missed_ones(path: Path) -> None:
    record(path, 2)
    findings = RunFindings()
    for number, entry in enumerate(in_tick_order(RecordingReader(path))):
        if entry.topic != TICK or number % 100:
            findings.take(entry)
    assert findings.ticks + findings.summary().loop.deadline_misses == 2_000
    assert findings.ticks < 1_990


@pytest.mark.parametrize("command", [("replay",), ("report",), ("export", "--to", "csv")])
def test_a_file_that_is_no_recording_is_refused_in_one_line(
    command: tuple[str, ...], tmp_path: Path
) -> None:
    path = tmp_path / "x.mcap"
    path.write_text(json.dumps({"not": "mcap"}), encoding="utf-8")
    result = run(MODULE, *command, str(path))
    assert result.returncode == 2
    assert result.stderr == f"telepulse: {path}: is not an MCAP file\n"
    assert not list(tmp_path.glob("x*/*"))
