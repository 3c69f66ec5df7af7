"""Figures for a phone: nothing is beside the figure."""

import pytest

pytest.importorskip("matplotlib")

from telepulse.reports.narrow import NarrowFigure

INCHES = (4.8, 5.0)
LONG = [f"an entry of a legend with many words {number}" for number in range(4)]


@pytest.mark.parametrize("outside", [True, False])
def test_a_legend_is_no_wider_than_the_figure(outside: bool) -> None:
    figure = NarrowFigure(figsize=INCHES, layout="constrained")
    axes = figure.subplots()
    for label in LONG:
        axes.plot([0, 1], [0, 1], label=label)
    if outside:
        legend = figure.legend(loc="outside lower center", ncols=4, fontsize="small")
    else:
        legend = axes.legend(ncols=4)
    figure.draw_without_rendering()
    assert legend.get_window_extent().width < figure.bbox.width
    assert [text.get_text() for text in legend.get_texts()] == LONG
    assert len(figure.legends) == outside
    # The axes keep their room.
    assert axes.get_window_extent().width > 0.7 * figure.bbox.width


def test_panels_side_by_side_are_stacked_with_their_labels() -> None:
    figure = NarrowFigure(figsize=INCHES, layout="constrained")
    left, right = figure.subplots(1, 2, sharey=True)
    left.set_ylabel("force over the height of a beat")
    figure.fit()
    figure.draw_without_rendering()
    above, below = left.get_window_extent(), right.get_window_extent()
    assert above.y0 > below.y1
    assert above.width == pytest.approx(below.width, rel=0.05)
    assert right.get_ylabel() == left.get_ylabel()
    for axes in (left, right):
        label = axes.yaxis.label.get_window_extent()
        assert 0 <= label.y0 < label.y1 <= figure.bbox.height


def test_panels_below_each_other_stay() -> None:
    figure = NarrowFigure(figsize=INCHES, layout="constrained")
    figure.subplots(2, 1, sharex=True)
    figure.fit()
    assert tuple(figure.get_size_inches()) == INCHES


def test_a_long_label_is_broken() -> None:
    figure = NarrowFigure(figsize=INCHES, layout="constrained")
    axes = figure.subplots()
    axes.set_xlabel("difference of the aligned force error, % of the pulse from peak to peak")
    figure.fit()
    figure.draw_without_rendering()
    label = axes.xaxis.label.get_window_extent()
    assert 0 <= label.x0 < label.x1 <= figure.bbox.width
    assert label.y0 >= 0
