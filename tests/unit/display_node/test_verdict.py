"""The verdict: what a person reads of a run, and whether the run is valid."""

from dataclasses import replace

import pytest

from display_node.reception.reachability import NOBODY
from display_node.verdict import MOST_LINES, verdict
from protocol.faults import Note, Part
from protocol.refusals import CAUSE_MEANINGS, Reason
from protocol.summary.fields import (
    Availability,
    BeatFigures,
    Clock,
    Deadlines,
    Interruptions,
    Loop,
    OneWayDelay,
    PlayoutDelay,
    RmsErrors,
    SampleCounts,
    Summary,
)
from tests.support.given_faults import FILM_LOST, MISSED

FINE = Summary(
    samples=SampleCounts(sent=15_000, played=9_000, predicted=6_000, late=0, lost=0),
    one_way_delay_ms=OneWayDelay(p50=0.85, p99=3.25),
    playout_delay_ms=PlayoutDelay(mean=6.82),
    beats=BeatFigures(count=17, rate_per_min=75.6, height_n=0.6, height_at_finger_n=0.3),
    clock=Clock(offset_ms=0.01),
    force_rmse_n=RmsErrors(aligned=0.0009, in_phase=0.0321),
    within_jnd=0.996,
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
            "The force was off by 0.9 mN (force RMSE, aligned), 0.3 % of the pulse's height; a"
            " finger notices 10 % or more, for 0.4 % of the time.",
            "The finger felt the pulse 6.8 ms after the wrist on average, off by 32.1 mN in phase;"
            " the network took 0.8 ms (99 % within 3.2 ms).",
            "None of the 15000 samples was lost or came too late.",
            "Nothing is wrong.",
        ),
        True,
    )


def test_a_delay_beyond_the_range_is_a_bound() -> None:
    beyond = OneWayDelay(p50=2000.0, p99=2000.0, max=30_125.0, beyond=["p50", "p99"])
    lines, _ = verdict(replace(FINE, one_way_delay_ms=beyond))
    assert any(
        line.endswith("the network took over 2000.0 ms (at most 30125.0 ms).") for line in lines
    )


REFUSED = Reason("tcp://wrist:5555 does not allow it", "there: telepulse keys allow finger.pub")
NOT_FELT = {"availability": Availability(9.0, felt=0.0, waiting=0.99)}


@pytest.mark.parametrize(
    ("change", "first"),
    [
        (
            {"faults": [FILM_LOST]},
            "it stopped at the fault 'film: feedback lost'.",
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
            NOT_FELT | {"clock": Clock(), "rejected_readers": {"no_key": 7}},
            "no pulse was felt; the sensing node did not answer: check its address, and"
            " that it runs.",
        ),
        (
            NOT_FELT
            | {"waiting_for": [Reason("nobody listens at tcp://wrist:5555", NOBODY.further)]},
            "no pulse was felt; nobody listens at tcp://wrist:5555;"
            " start the sensing node there, or check the address.",
        ),
        (
            NOT_FELT | {"waiting_for": [Reason("no answer from a"), Reason("no route to b")]},
            "no pulse was felt; no answer from a; no route to b.",
        ),
        (
            NOT_FELT
            | {"rejected": {"refused_key": 7}, "refused": "refused_key", "waiting_for": [REFUSED]},
            f"no pulse was felt; {REFUSED}.",
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
    ids=[
        *("fault", "missed ticks", "no answer", "refused", "refused reader"),
        *("nobody", "two addresses"),
        "refused at the end",
        *("no samples", "too short"),
    ],
)
def test_a_ruined_run_says_so_in_its_first_line(change: dict[str, object], first: str) -> None:
    lines, valid = verdict(replace(FINE, **change))
    assert not valid
    assert lines[0].startswith(f"This run is not valid: {first}")
    assert "Nothing is wrong." not in lines
    assert len(lines) <= MOST_LINES


def test_after_a_fault_the_felt_pulse_is_one_of_before() -> None:
    stopped = replace(
        FINE,
        faults=[FILM_LOST],
        samples=SampleCounts(sent=15_000, played=9_000, predicted=5_900, late=100, lost=0),
        availability=replace(FINE.availability, felt=0.2, faulted=0.7),
    )
    first, felt, error, delay, lost = verdict(stopped).lines
    assert first == "This run is not valid: it stopped at the fault 'film: feedback lost'."
    assert felt.startswith("Before the fault the pulse was felt for 3.2 of 16.0 s")
    assert error.startswith("Before the fault the force was off by 0.9 mN")
    assert delay.startswith("Before the fault the finger felt the pulse 6.8 ms after the wrist")
    assert lost == "Of 15000 samples, 100 came too late (0.7 %)."


def test_notes_of_sensors_are_no_faults() -> None:
    noted = replace(FINE, notes=[MISSED, Note(Part.SENSOR, "2 samples beyond 20 N")])
    lines, valid = verdict(noted)
    assert valid
    assert lines[-2:] == (
        "The film's sensor: 3 samples missing.",
        "The sensing node: 2 samples beyond 20 N.",
    )


def test_refused_readers_are_told_apart_from_the_link() -> None:
    refused = {"rejected": {"malformed": 2}, "rejected_readers": {"no_key": 5, "mark": 1}}
    *_, of_link, of_readers = verdict(replace(FINE, **refused)).lines
    assert of_link == f"Refused: {CAUSE_MEANINGS['malformed']} (2 times)."
    assert of_readers == (
        f"Refused readers of the telemetry: {CAUSE_MEANINGS['no_key']} (5 times), and 1 others."
    )


def test_of_several_contactors_the_worst_is_named() -> None:
    contactors = {
        name: Summary(
            beats=BeatFigures(rate_per_min=75.6, height_n=0.6, height_at_finger_n=0.3),
            force_rmse_n=RmsErrors(aligned=error_n),
            within_jnd=share,
        )
        for name, error_n, share in (("cun", 0.001, 1.0), ("guan", 0.02, 0.8))
    }
    lines, _ = verdict(replace(FINE, contactors=contactors))
    assert lines[1].startswith(
        "The force at guan, the worst contactor, was off by 20.0 mN (force RMSE, aligned), 6.7"
    )
    assert "The error at guan was large enough to notice for 20 % of the time" in lines[4]
