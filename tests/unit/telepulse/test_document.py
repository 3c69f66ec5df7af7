"""The page of a report: its findings first, contents, folded chapters, and words as code."""

import io
import re
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING
from xml.etree import ElementTree

import pytest
from rich.console import Console

from protocol.provenance import Provenance
from telepulse.document import (
    LINES,
    Chapter,
    Plot,
    Report,
    Table,
    print_tables,
    provenance_table,
    read_chapters,
    write_report,
)

if TYPE_CHECKING:
    from matplotlib.figure import Figure

ROWS = Table("A table", ("what", "how much", "why"), [("`one`", "1 < 2", "")], note="With `code`.")
MADE = Provenance("1.2.3", "", None, "2026-01-02T03:04:05Z", "", "", "", ["telepulse", "a b"])
REPORT = Report(
    "A title",
    (
        Chapter("First", ("See `telepulse tune`.",), (ROWS,), findings=("It works.", "`It` is 2.")),
        Chapter("Second <b>", folded=True, findings=("It is <b>small</b>.",)),
    ),
    MADE,
)


def page(folder: Path, report: Report = REPORT) -> str:
    return write_report(report, folder).read_text("utf-8")


def test_the_findings_of_all_chapters_come_first(tmp_path: Path) -> None:
    written = page(tmp_path)
    findings = re.findall(r"<li>(.*)</li>", written.partition("<nav")[0])
    assert findings == [
        "It works.",
        "<code>It</code> is 2.",
        "It is &lt;b&gt;small&lt;/b&gt;.",
    ]
    assert "telepulse 1.2.3, 2026-01-02 03:04 UTC: <code>telepulse 'a b'</code>" in written
    assert REPORT.to_dict()["findings"] == REPORT.findings


def test_each_chapter_is_in_the_contents_and_has_an_anchor(tmp_path: Path) -> None:
    written = page(tmp_path)
    linked = re.findall(r"<nav.*</nav>", written, re.DOTALL)[0]
    for number, title in enumerate(("First", "Second &lt;b&gt;", "Provenance of this report"), 1):
        assert f'<a href="#chapter-{number}">{title}</a>' in linked
        assert written.count(f'id="chapter-{number}"') == 1
    # The second chapter and the provenance.
    assert written.count("<details>") == written.count("</details>") == 2


def test_no_markup_is_left_as_text_and_cells_name_their_columns(tmp_path: Path) -> None:
    written = page(tmp_path)
    body = written[written.index("<body>") :]
    assert "`" not in re.sub(r"&#39;", "", body)
    assert '<td data-column="how much" class="short">1 &lt; 2</td>' in body
    assert '<td data-column="what" class="short"><code>one</code></td>' in body


def test_a_terminal_ends_with_the_findings() -> None:
    printed = io.StringIO()
    print_tables(REPORT, Console(file=printed, width=60))
    assert printed.getvalue().splitlines()[-3:] == REPORT.findings


def test_tables_and_plots_stand_among_the_paragraphs(tmp_path: Path) -> None:
    plot = Plot("line", "A line.", lambda figure: None)
    report = Report("A title", (Chapter("First", ("words", ROWS, plot, "more words")),))
    written = page(tmp_path, report)
    places = [written.index(text) for text in ("<p>words", "1 &lt; 2", "line.svg", "<p>more words")]
    assert places == sorted(places)
    chapter = report.to_dict()["chapters"][0]
    assert chapter["paragraphs"] == ["words", "more words"]
    assert chapter["tables"][0]["rows"] == [{"what": "`one`", "how much": "1 < 2", "why": ""}]


def test_what_has_no_title_opens_the_page(tmp_path: Path) -> None:
    report = replace(REPORT, chapters=(Chapter("", ("the words",)), *REPORT.chapters))
    written = page(tmp_path, report)
    assert written.index("the words") < written.index("<li>") < written.index("<nav")
    assert "<h2 id" in written
    assert 'href="#chapter-1">First' in written


def test_a_markdown_text_is_read_as_chapters_in_its_order() -> None:
    text = """
| what | how much |
|---|---|
| a \\| b | 1 < 2 |

> Two lines of
> one finding.

## First

Words with `code`
and *no* other <b>markup</b>.

![Its title](numbers)

![Its caption, of
two lines.](line)
"""
    plot = Plot("line", "", lambda figure: None)
    opening, first = read_chapters(text, {"numbers": ROWS, "line": plot})
    assert (opening.title, first.title) == ("", "First")
    assert opening.blocks == [Table("", ["what", "how much"], [["a | b", "1 < 2"]])]
    assert opening.findings == ("Two lines of one finding.",)
    assert first.blocks == [
        "Words with `code` and *no* other <b>markup</b>.",
        replace(ROWS, title="Its title"),
        replace(plot, caption="Its caption, of two lines."),
    ]


HOSTILE = '<script>alert(1)</script> ![x](http://a.example/x.png) "\' onload="x" </title>'


def test_text_of_a_recording_is_text_on_the_page_and_in_a_plot(tmp_path: Path) -> None:
    def draw(figure: "Figure") -> None:
        figure.subplots().set_xlabel(HOSTILE)

    table = Table(HOSTILE, (HOSTILE, HOSTILE), [(HOSTILE, HOSTILE)], note=HOSTILE)
    plot = Plot("line", HOSTILE, draw)
    chapter = Chapter(HOSTILE, (HOSTILE, f"`{HOSTILE}`"), (table,), (plot,), (HOSTILE,))
    written = page(tmp_path, Report(HOSTILE, (chapter, chapter, chapter)))
    assert not re.findall(r"<script|<img(?! src=\"line.svg\" alt=\"[^\"]*\">)", written)
    assert re.findall(r'(?:src|href)="([^"#]+)"', written) == ["line.svg"] * 3
    drawn = ElementTree.parse(tmp_path / "line.svg")
    tags = {element.tag.rpartition("}")[2] for element in drawn.iter()}
    assert "text" in tags
    assert "script" not in tags
    assert HOSTILE in {element.text for element in drawn.iter()}


def test_a_provenance_is_read_by_people() -> None:
    scene = {"path": "a.toml", "tables": {"display": {"tick": "1 ms", "contactor": [{"kp": 2}]}}}
    made = {
        "version": "1.2.3",
        "start_utc": "2026-01-02T03:04:05.678+00:00",
        # As in a recording, where tables are texts.
        "command": '["telepulse", "a b"]',
        "scene": scene,
        "effective": {"display": {"actuator": {"kp": 1.0}, "feed_forward": True, "drive": None}},
        "actuator": {"kp": 1.0},
    }
    rows = dict(provenance_table("made", made).rows)
    assert rows == {
        "version of telepulse": "1.2.3",
        "start (UTC)": "2026-01-02 03:04:05",
        "command": "`telepulse 'a b'`",
        "scene as written": "",
        "`path`": "a.toml",
        "`display.tick`": "1 ms",
        "`display.contactor.0.kp`": "2",
        "settings in effect": "",
        "`display.actuator.kp`": "1",
        "`display.feed_forward`": "true",
        "`display.drive`": "–",
    }


def luminance(colour: str) -> float:
    """Return the relative luminance of an sRGB colour, as WCAG defines it."""
    parts = [int(colour[at : at + 2], 16) / 255 for at in (1, 3, 5)]
    linear = [
        part / 12.92 if part <= 0.04045 else ((part + 0.055) / 1.055) ** 2.4 for part in parts
    ]
    return sum(weight * part for weight, part in zip((0.2126, 0.7152, 0.0722), linear, strict=True))


@pytest.mark.parametrize("ground", ["#ffffff", "#14181d"])
@pytest.mark.parametrize("colour", LINES)
def test_a_line_of_a_plot_has_a_contrast_of_three_on_both_pages(colour: str, ground: str) -> None:
    dark, light = sorted((luminance(colour), luminance(ground)))
    assert (light + 0.05) / (dark + 0.05) >= 3
