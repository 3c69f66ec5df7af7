"""Figures of the press: set-points from the finger to the wrist, and their account."""

from dataclasses import dataclass

from protocol.figures import figure


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
