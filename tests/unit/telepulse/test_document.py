"""The page of a report: foreign text is text, and lines are seen."""

import re
from pathlib import Path
from typing import TYPE_CHECKING
from xml.etree import ElementTree

import pytest

from telepulse.document import (
    LINES,
    Chapter,
    Plot,
    Report,
    Table,
    write_report,
)
from telepulse.view.plots import FINGER_COLOURS

if TYPE_CHECKING:
    from matplotlib.figure import Figure

HOSTILE = '<script>alert(1)</script> ![x](http://a.example/x.png) "\' onload="x" </title>'


def test_text_of_a_recording_is_text_on_the_page_and_in_a_plot(tmp_path: Path) -> None:
    def draw(figure: "Figure") -> None:
        figure.subplots().set_xlabel(HOSTILE)

    table = Table(HOSTILE, (HOSTILE, HOSTILE), [(HOSTILE, HOSTILE)], note=HOSTILE)
    plot = Plot("line", HOSTILE, draw)
    chapter = Chapter(HOSTILE, (HOSTILE, f"`{HOSTILE}`"), (table,), (plot,), (HOSTILE,))
    report = Report(HOSTILE, (chapter, chapter, chapter))
    written = write_report(report, tmp_path).read_text("utf-8")
    assert not re.findall(r"<script|<img(?! src=\"line.svg\" alt=\"[^\"]*\">)", written)
    assert re.findall(r'(?:src|href)="([^"#]+)"', written) == ["line.svg"] * 3
    drawn = ElementTree.parse(tmp_path / "line.svg")
    tags = {element.tag.rpartition("}")[2] for element in drawn.iter()}
    assert "text" in tags
    assert "script" not in tags
    assert HOSTILE in {element.text for element in drawn.iter()}


def luminance(colour: str) -> float:
    """Return the relative luminance of an sRGB colour, as WCAG defines it."""
    parts = [int(colour[at : at + 2], 16) / 255 for at in (1, 3, 5)]
    linear = [
        part / 12.92 if part <= 0.04045 else ((part + 0.055) / 1.055) ** 2.4 for part in parts
    ]
    return sum(weight * part for weight, part in zip((0.2126, 0.7152, 0.0722), linear, strict=True))


@pytest.mark.parametrize("ground", ["#ffffff", "#14181d", "#1a2027"])
@pytest.mark.parametrize("colour", sorted({*LINES, *FINGER_COLOURS}))
def test_a_line_of_a_plot_has_a_contrast_of_three_on_both_pages(colour: str, ground: str) -> None:
    dark, light = sorted((luminance(colour), luminance(ground)))
    assert (light + 0.05) / (dark + 0.05) >= 3
