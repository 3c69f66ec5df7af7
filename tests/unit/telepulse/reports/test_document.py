"""The page of a report: its findings first, contents, folded chapters, and words as code."""

import io
import re
from pathlib import Path

from rich.console import Console

from protocol.provenance import Provenance
from telepulse.reports.document import Chapter, Report, Table, print_tables, write_report

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
    assert "telepulse 1.2.3, 2026-01-02 03:04 UTC: <code>telepulse &#39;a b&#39;</code>" in written
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
    assert '<td data-column="how much">1 &lt; 2</td>' in body
    assert '<td data-column="what"><code>one</code></td>' in body


def test_a_terminal_ends_with_the_findings() -> None:
    printed = io.StringIO()
    print_tables(REPORT, Console(file=printed, width=60))
    assert printed.getvalue().splitlines()[-3:] == REPORT.findings
