"""The closing verdict: what a person reads of a run, and whether the run is valid."""

from dataclasses import replace

import pytest

from display_node.verdict import MOST_LINES, verdict
from protocol.summary.tables import (
    AlignedErrors,
    Availability,
    BeatFigures,
    Clock,
    Compensation,
    Deadlines,
    Interruptions,
    Limited,
    Limits,
    Loop,
    OneWayDelay,
    PlayoutDelay,
    SampleCounts,
    Summary,
)

FINE = Summary(
    samples=SampleCounts(sent=15_000, played=9_000, predicted=6_000, late=0, lost=0),
    one_way_delay_ms=OneWayDelay(p50=0.85, p99=3.25),
    playout_delay_ms=PlayoutDelay(mean=6.82),
    beats=BeatFigures(count=17, rate_per_min=75.6, height_n=0.3),
    clock=Clock(offset_ms=0.01),
    force_rmse_n=AlignedErrors(aligned=0.0009),
    within_jnd=1.0,
    availability=Availability(
        16.0, felt=0.9, starting=0.02, waiting=0.05, ended=0.03, missed=0.001, played=0.92
    ),
    interruptions=Interruptions(0, 0.0, 0.0),
    loop=Loop(worst_5s=Deadlines(missed=0.002, gap_ms=6.0)),
    rejected={"before_clock": 3, "duplicate": 40},
)


def test_a_good_run_is_told_in_five_lines() -> None:
    assert verdict(FINE) == (
        (
            "The pulse was felt for 14.4 of 16.0 s, at 76 beats a minute; start and end took 1.6"
            " s.",
            "The force was off by 0.9 mN RMS, 0.3 % of the pulse's height; a finger notices 10 % or"
            " more.",
            "The finger felt the pulse 6.8 ms after the wrist on average; the network took 0.8 ms"
            " (99 % within 3.2 ms).",
            "None of the 15000 samples was lost or came too late.",
            "Nothing is wrong.",
        ),
        True,
    )


def test_losses_and_a_prediction_ahead_of_the_network_are_no_alarm() -> None:
    far = replace(
        FINE,
        samples=SampleCounts(sent=15_000, played=5_000, predicted=9_800, late=26, lost=174),
        one_way_delay_ms=OneWayDelay(p50=40.0, p99=64.0),
        playout_delay_ms=PlayoutDelay(mean=-0.2),
        compensation=Compensation(predicted=0.7, corrections=0),
    )
    lines, valid = verdict(far)
    assert valid
    assert lines[2:] == (
        "The finger felt the pulse 0.0 ms after the wrist on average, thanks to prediction; the"
        " network took 40.0 ms (99 % within 64.0 ms).",
        "Of 15000 samples, 174 were lost and 26 came too late (1.3 %); the finger felt no gap.",
        "Nothing is wrong.",
    )


NOT_FELT = {"availability": Availability(9.0, felt=0.0, waiting=0.99)}


@pytest.mark.parametrize(
    ("change", "first"),
    [
        (
            {"faults": ["force limit"]},
            "the display stopped at the fault 'force limit'.",
        ),
        (
            {"availability": Availability(16.0, felt=0.1, waiting=0.02, missed=0.88)},
            "88 % of the ticks were missed: this computer was too busy, or too slow;"
            " display-node --doctor names what helps.",
        ),
        (
            NOT_FELT | {"clock": Clock()},
            "no pulse was felt; the sensing node did not answer: check its address, and"
            " that it runs.",
        ),
        (
            NOT_FELT | {"clock": Clock(), "rejected": {"refused_key": 7}},
            "no pulse was felt; connections refused because the other node's allow-list"
            " lacks this node's key (7 times).",
        ),
        (
            NOT_FELT | {"waiting_for": "nobody listens at tcp://wrist:5555, refused 12 times"},
            "no pulse was felt; nobody listens at tcp://wrist:5555, refused 12 times;"
            " start the sensing node there, or check the address.",
        ),
        (
            NOT_FELT | {"samples": SampleCounts(sent=0)},
            "no pulse was felt; the sensing node sent no samples: check its source.",
        ),
        (
            {"availability": Availability()},
            "no pulse was felt; the stream ended, or",
        ),
    ],
    ids=["fault", "missed ticks", "no answer", "refused", "nobody", "no samples", "too short"],
)
def test_a_ruined_run_says_so_in_its_first_line(change: dict[str, object], first: str) -> None:
    lines, valid = verdict(replace(FINE, **change))
    assert not valid
    assert lines[0].startswith(f"This run is not valid: {first}")
    assert "Nothing is wrong." not in lines
    assert len(lines) <= MOST_LINES


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"interruptions": Interruptions(1, 2.04, 2.04)}, "The pulse stopped once, for 2.0 s"),
        ({"loop": Loop(worst_5s=Deadlines(0.03, 9.0))}, "in the worst 5 s 3.0 % of the ticks"),
        ({"loop": Loop(worst_5s=Deadlines(0.001, 90.0))}, "This computer was too busy"),
        ({"faults": ["sensing node: 2 samples late"]}, "The sensing node: 2 samples late."),
        ({"within_jnd": 0.7}, "The error was large enough to notice for 30 % of the time"),
        (
            {"limited": Limits(force=Limited(3, 2.0, 0.125))},
            "For 12 % of the time the force limit cut the pulse: check",
        ),
        (
            {"rejected": {"truncated": 2, "crc": 1}},
            "or bytes were lost (2 times), and 1 others.",
        ),
    ],
    ids=["stops", "missed ticks", "gap", "note", "errors", "limit", "refused"],
)
def test_what_is_wrong_has_a_line_of_its_own(change: dict[str, object], words: str) -> None:
    lines, valid = verdict(replace(FINE, **change))
    assert valid
    assert any(words in line for line in lines)
    assert "Nothing is wrong." not in lines


def test_more_than_fits_is_counted() -> None:
    bad = replace(
        FINE,
        interruptions=Interruptions(4, 2.0, 1.0),
        loop=Loop(worst_5s=Deadlines(0.05, 60.0)),
        within_jnd=0.5,
        rejected={"truncated": 2},
    )
    lines, _ = verdict(bad)
    assert len(lines) == MOST_LINES
    assert lines[-1].endswith("(And 2 more.)")


def test_of_several_contactors_the_worst_is_named() -> None:
    contactors = {
        name: Summary(
            beats=BeatFigures(rate_per_min=75.6, height_n=0.3),
            force_rmse_n=AlignedErrors(aligned=error_n),
            within_jnd=share,
        )
        for name, error_n, share in (("cun", 0.001, 1.0), ("guan", 0.02, 0.8))
    }
    lines, _ = verdict(replace(FINE, contactors=contactors))
    assert lines[1].startswith(
        "The force at guan, the worst contactor, was off by 20.0 mN RMS, 6.7"
    )
    assert "The error at guan was large enough to notice for 20 % of the time" in lines[4]
