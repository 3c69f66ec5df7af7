"""Figures of the press: set-points from the finger to the wrist, and their account."""

from dataclasses import dataclass

from protocol.figures import NEWTONS, RATIO, Surface, absent, figure

OWN = absent("The page has a figure of them.", Surface.PAGE)


@dataclass(frozen=True, slots=True)
class SetPointCounts:
    """sent = applied + superseded + lost.

    At the wrist, those after the newest one that arrived are not known, and not counted as sent.
    """

    sent: int | None = figure(
        "Set-points sent: sent = applied + superseded + lost",
        "{} sent",
        metric="set_points_sent_total",
    )
    applied: int | None = figure(
        "Set-points that the probe followed",
        "{} applied",
        metric='set_points_total{outcome="applied"}',
        separator=" = ",
        prominent=True,
    )
    superseded: int | None = figure(
        "Set-points that arrived after a newer one, or when they were no longer valid",
        "{} superseded",
        metric='set_points_total{outcome="superseded"}',
        separator=" + ",
    )
    lost: int | None = figure(
        "Set-points that have not arrived", "{} lost", metric="set_points_lost", separator=" + "
    )


@dataclass(frozen=True, slots=True)
class PressFigures(SetPointCounts):
    """The account of the set-points, and the state of the press."""

    press_n: float | None = figure(
        "Static force of the finger",
        "finger {}",
        NEWTONS._replace(form=".0f"),
        metric="press_newtons",
        absent=OWN,
    )
    hold_down_n: float | None = figure(
        "Static force of the probe on the wrist, as last reported",
        "wrist {}",
        NEWTONS._replace(form=".0f"),
        metric="hold_down_newtons",
        absent=OWN,
    )
    loop_gain: float | None = figure(
        "Measured gain of the loop through the network: the share of a change of the hold-down that"
        " comes back to the set-point",
        "loop gain {}",
        RATIO._replace(form=".4f"),
        metric="press_loop_gain_ratio",
        absent=OWN,
    )
    probe: str | None = figure(
        "State of the probe: off, pressing, easing, leaving or fault; held while another display"
        " presses",
        "probe {}",
        metric="probe",
        show=lambda state: state or None,
        label="state",
        absent=OWN,
    )
