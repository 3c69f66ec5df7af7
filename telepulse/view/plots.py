"""Plots of the page: their curves, axes and notes."""

from typing import NamedTuple

# Colours that have a contrast of at least 3 on the card of either theme.
SENSED, FELT, MUTED, WRONG = "#e06c08", "#2f7fd6", "#7d8894", "#e04352"
# Colours of several contactors, in their order.
FINGER_COLOURS = (
    *("#2f7fd6", "#e06c08", "#1f9a5b", "#e04352"),
    *("#9a63d8", "#8a7a14", "#d6459a", "#128f9c"),
)
# Displays of a wrist that is pressed, and those whose finger does not press.
PRESSED, UNPRESSED = "pressed", "unpressed"
GREEN, VIOLET, OLIVE = FINGER_COLOURS[2], FINGER_COLOURS[4], FINGER_COLOURS[5]


class EventLine(NamedTuple):
    """A vertical line in the plots over time, at an event of a kind; width in pixels."""

    words: str
    colour: str
    dash: str
    width: int


# By the kind of an event: its level, or that it is a mark.
INFORMATION, MARK = "information", "mark"
EVENT_LINES = {
    INFORMATION: EventLine("information", MUTED, "dotted", 2),
    "warning": EventLine("warning", OLIVE, "dashed", 2),
    "error": EventLine("error", WRONG, "solid", 2),
    MARK: EventLine("mark", VIOLET, "solid", 4),
}


class Curve(NamedTuple):
    """A curve; name: name of its columns; words: its text in the legend.

    marker: shape of its points, which no line then joins.
    """

    name: str
    words: str
    colour: str
    dash: str = "solid"
    marker: str = ""


class PagePlot(NamedTuple):
    """A plot; id: its element on the page; axis: label and least range; note: text below it.

    empty: text shown while no curve has a value. of_contactor: whether it shows the chosen one of
    several contactors. across: label of the horizontal axis, where that is not the time. only: of
    which displays it is shown, if not of all. group: of which folded part of the page it is; empty
    for those that are always seen.
    """

    id: str
    title: str
    axis: str
    least: tuple[float, float]
    curves: tuple[Curve, ...]
    empty: str
    note: str = ""
    of_contactor: bool = False
    across: str = ""
    only: str = ""
    group: str = ""

    @property
    def unit(self) -> str:
        """Unit of the values, from the label of their axis."""
        return self.axis[self.axis.index("(") + 1 : -1]


PLOTS = (
    PagePlot(
        *("force", "Force", "force (mN)", (0.0, 1.0)),
        (
            Curve("wrist", "at the wrist", SENSED),
            Curve("finger", "felt at the finger", FELT),
            Curve("target", "target there", GREEN, "dashed"),
            Curve("onset", "onset of a beat", SENSED, marker="circle"),
            Curve("doubtful", "onset of a doubtful beat", WRONG, marker="x"),
        ),
        "No sample from the wrist and no tick of the display in this window.",
        "The finger follows by the playout delay. A beat is marked when the next one has begun."
        " Where a finger presses, its force contains the press.",
        of_contactor=True,
    ),
    PagePlot(
        *("error", "Error of the force felt", "error (mN)", (-1.0, 1.0)),
        (
            Curve("in_phase", "in phase: against the pulse at that instant", SENSED),
            Curve("aligned", "aligned: against the instant that is played", FELT),
        ),
        "No instant of this window is judged: the pulse was not felt at its full strength, or the"
        " wrist's samples have not arrived.",
        "Grey band: the just noticeable difference of force, here 10 % of the pulse's peak to peak."
        " A finger notices differences of 7 to 10 %.",
        of_contactor=True,
        only=UNPRESSED,
        group="prediction",
    ),
    PagePlot(
        *("press", "Press", "force (N)", (0.0, 0.1)),
        (
            Curve("hold_down", "hold-down at the wrist", SENSED),
            Curve("finger_press", "press of the finger, or of the sweep", FELT),
        ),
        "No force of a finger or a probe in this window.",
        "The probe at the wrist presses with the force of the finger. The pulse is not part of it.",
        only=PRESSED,
        group="press",
    ),
    PagePlot(
        *("depth", "Height of the pulse by hold-down", "height (mN)", (0.0, 1.0)),
        (
            Curve("depth_beats", "a beat", SENSED, marker="circle"),
            Curve("depth_doubtful", "a doubtful beat", WRONG, marker="x"),
            Curve("depth_curve", "curve", SENSED),
            Curve("light", "light", GREEN, "dashed"),
            Curve("deeper", "deeper: the best", FELT),
            Curve("deepest", "deepest", VIOLET, "dashed"),
            Curve("depth_now", "now", MUTED, "dotted"),
        ),
        "No beat at a steady hold-down yet.",
        "All beats at a steady hold-down since the start. The best hold-down is that of the highest"
        " pulse; light and deepest are where the height is half of that.",
        across="hold-down at the wrist (N)",
        only=PRESSED,
        group="press",
    ),
    PagePlot(
        *("shape", "Shape of the pulse by hold-down", "share (%)", (0.0, 60.0)),
        (
            Curve("shape_mean", "mean, of the height", SENSED, marker="circle"),
            Curve("shape_upstroke", "upstroke, of the beat", FELT, marker="triangle"),
            Curve("shape_flat", "flat, of the beat", VIOLET, marker="square"),
        ),
        "No beat at a steady hold-down yet.",
        "Flat: within a tenth of the height above the foot. It grows where the artery is closed"
        " between beats: beyond the best hold-down.",
        across="hold-down at the wrist (N)",
        only=PRESSED,
        group="press",
    ),
    PagePlot(
        *("height", "Height of the beats at the wrist", "height (mN)", (0.0, 1.0)),
        (Curve("height", "from foot to peak", SENSED),),
        "No beat was found in this window. The first one takes some seconds.",
        of_contactor=True,
        group="pulse",
    ),
    PagePlot(
        *("delay", "Delays", "delay (ms)", (0.0, 1.0)),
        (Curve("one_way", "one-way delay", SENSED), Curve("playout", "playout delay", FELT)),
        "No frame has arrived in this window, or the clocks are not related yet.",
        group="link",
    ),
    PagePlot(
        *("loss", "Loss", "samples (%)", (0.0, 1.0)),
        (Curve("lost", "lost", SENSED), Curve("late", "late", FELT, "dashed")),
        "No sample was due in this window.",
        group="link",
    ),
    PagePlot(
        *("predictor", "Predictor: the error it expects", "RMS error (mN)", (0.0, 1.0)),
        (Curve("predictor", "where it stands in", FELT),),
        "The predictor has not stood in, or not learnt its error yet.",
        of_contactor=True,
        group="prediction",
    ),
    PagePlot(
        *("offset", "Clock offset, against now", "offset (ms)", (-0.01, 0.01)),
        (
            Curve("offset", "offset", FELT),
            Curve("offset_low", "uncertainty", MUTED, "dashed"),
            Curve("offset_high", "", MUTED, "dashed"),
        ),
        "The sensing node has not answered for its clock yet.",
        group="clock",
    ),
)
# Shown of several contactors, with a curve each.
FINGERS = PagePlot(
    *("fingers", "Forces at all fingers", "force (mN)", (0.0, 1.0), ()),
    "No tick of the display in this window.",
)
