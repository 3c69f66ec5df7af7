"""The study of prediction with an ECG: matching, faults, records, and its report's verdicts."""

import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from protocol.errors import SourceError
from sensing_node.sources.ecg import draw_ecg
from telepulse.reports.studies import announce_study
from telepulse.reports.studies.announce_detector import DetectorScore, score_lead
from telepulse.reports.studies.announce_oracle import OracleErrors
from telepulse.reports.studies.announce_pulses import (
    FAULTS,
    JUMP,
    TRANSIT_S,
    AnnouncedPulse,
    EcgFault,
    announced_pulses,
    with_fault,
)
from telepulse.reports.studies.announce_records import AnnotatedLead, annotated_leads
from telepulse.reports.studies.announce_report import bars, report_announce
from telepulse.reports.studies.announce_study import (
    AnnounceEffort,
    AnnounceScores,
    BothErrors,
    FoundOut,
    PulseErrors,
)
from telepulse.reports.studies.prediction_pulses import RATE_HZ, drawn_beats

# Pulses are normalised by what follows 20 s.
SECONDS = 22.0
BEATS_S = np.arange(1.0, 60.0, 0.8)


def lead(beats_s: np.ndarray, annotated_s: np.ndarray) -> AnnotatedLead:
    t_s = np.arange(0, 61, 1 / 250.0)
    return AnnotatedLead("lead", 250.0, draw_ecg(t_s, [(at, 1.0) for at in beats_s]), annotated_s)


def test_a_lead_without_errors_has_sensitivity_and_precision_of_1() -> None:
    score = score_lead(lead(BEATS_S, BEATS_S + 0.01))
    assert (score.sensitivity, score.precision) == (1.0, 1.0)
    assert score.deviation_ms < 3
    assert 20 < score.latency_ms < 50


def test_missed_and_false_r_waves_are_counted() -> None:
    annotated = np.sort(np.append(np.delete(BEATS_S, [30, 31, 32]), BEATS_S[[20, 40]] + 0.4))
    score = score_lead(lead(BEATS_S, annotated))
    assert (score.missed, score.false) == (2, 3)
    late = score_lead(lead(BEATS_S, BEATS_S + 0.17))
    assert late.sensitivity < 0.05


def test_r_waves_of_a_synthetic_ecg_precede_the_onsets() -> None:
    (first, *_), beats = announced_pulses(SECONDS, 1, 0.0), drawn_beats(SECONDS, 1)["variability"]
    for onset_s in beats.onsets_s[3:8]:
        at = round((onset_s - TRANSIT_S) * RATE_HZ)
        around = first.ecg_mv[at - 100 : at + 100]
        assert abs(int(around.argmax()) - 100) <= 3


@pytest.mark.parametrize("ecg_fault", FAULTS, ids=[each.name for each in FAULTS])
def test_a_fault_changes_the_ecg_from_its_time_on(ecg_fault: EcgFault) -> None:
    whole = announced_pulses(SECONDS, 1, 0.0)[0]
    wrong = with_fault(whole, ecg_fault, 5.0)
    assert len(wrong.ecg_mv) == len(whole.ecg_mv)
    np.testing.assert_array_equal(wrong.ecg_mv[:5_000], whole.ecg_mv[:5_000])
    assert np.abs(wrong.ecg_mv[5_000:] - whole.ecg_mv[5_000:]).max() > 0.5


def errors(name: str, *values: float) -> PulseErrors:
    """Return errors of 0.1 without the ECG, and of these values with it, one a seed."""
    return PulseErrors(
        name, tuple(BothErrors(name, (0.1,) * 4, (value,) * 4, 250.0, 5.0, 1.0) for value in values)
    )


def fault(
    name: str = "unplugged", seconds: float = 3.0, used: float = 0.05, after: float = 0.5
) -> FoundOut:
    return FoundOut("fibrillation", name, seconds, used, (0.5, 0.9), (0.5, after), after / 0.5 - 1)


MET = AnnounceScores(
    {
        0.005: [errors("fibrillation, shape cue", 0.15), errors("ectopic", 0.1, 0.16)],
        0.02: [errors("ectopic", 0.1, 0.1004)],
    },
    [fault(), fault(JUMP, used=1.0)],
    [DetectorScore("100, V5", 1000, 10, 0, 1.0, 45.0)],
    1.2,
)


@pytest.mark.parametrize(
    ("result", "missed"),
    [
        (MET, []),
        (
            replace(MET, errors=MET.errors | {0.005: [errors("fibrillation", 0.14, 0.152)]}),
            ["fibrillation, at worst of 2: 0.152 at 100 ms, at most 0.15"],
        ),
        (
            replace(MET, errors=MET.errors | {0.02: [errors("ectopic", 0.08, 0.101)]}),
            ["ectopic, jitter 20 ms: at its worst horizon +1.0 %, at most +0.5 %"],
        ),
        (
            replace(MET, faults=[fault(seconds=3.1)]),
            ["found out within 3.10 s, at most 3"],
        ),
        (
            replace(MET, faults=[fault(seconds=1.0, used=0.9)]),
            ["fibrillation, ECG unplugged: then used for 90.0 % of the time, at most 5 %"],
        ),
        (
            replace(MET, faults=[fault(JUMP, used=1.0, after=0.51)]),
            ["fibrillation, ECG jumps 0.1 s: then 0.510 at 100 ms, at most 0.500"],
        ),
    ],
)
def test_the_report_names_the_criteria_that_are_missed(
    result: AnnounceScores, missed: list[str]
) -> None:
    assert [what for what, reached in bars(result) if not reached] == missed
    report = report_announce(result, AnnounceEffort())
    text = " ".join(word for chapter in report.chapters for word in chapter.paragraphs)
    assert text.count("missed.") == len(missed)


def test_the_report_has_the_errors_of_a_transit_time_that_does_not_vary() -> None:
    limit = (errors("fibrillation", 0.07, 0.09),)
    chapter = report_announce(replace(MET, limit=limit), AnnounceEffort()).chapters[0]
    (row,) = chapter.tables[-1].rows
    assert row[:2] == ("fibrillation", "0.100 / 0.080")


def test_a_missed_criterion_names_what_an_oracle_reaches() -> None:
    """The mean of its seeds beside the mean, and the greatest beside the greatest."""
    oracle = tuple(OracleErrors("fibrillation", (0.01, 0.05, each)) for each in (0.1, 0.13))
    result = replace(MET, errors={0.005: [errors("fibrillation", 0.14, 0.18)]}, oracle=oracle)
    assert [what for what, reached in bars(result) if not reached] == [
        "fibrillation, on average of 2: 0.160 at 100 ms, at most 0.15, an oracle's 0.115",
        "fibrillation, at worst of 2: 0.180 at 100 ms, at most 0.15, an oracle's 0.130",
    ]
    chapter = report_announce(result, AnnounceEffort()).chapters[0]
    assert chapter.tables[-1].rows == [
        ("fibrillation", "0.010, 0.010", "0.050, 0.050", "0.115, 0.130")
    ]


def test_errors_are_collected_by_jitter_and_pulse(monkeypatch: pytest.MonkeyPatch) -> None:
    """Each pulse is run once without an ECG, and with one for each jitter and for none."""

    def errors_by_place(versions: tuple[AnnouncedPulse, ...]) -> list[BothErrors]:
        values = [0.1 * (place + 1) for place in range(len(versions))]
        return [
            BothErrors(str(each), (0.1,) * 4, (value,) * 4, 250.0, 5.0, 1.0)
            for each, value in zip(versions, values, strict=True)
        ]

    scorers = {
        "score_both": errors_by_place,
        "score_faults": lambda _: [fault()],
        "score_oracle": lambda case: OracleErrors(case[0], (0.0, 0.0, 0.1 * case[2])),
    }

    def computed(score: Callable[..., Any], cases: list[Any], _: str | None) -> list[Any]:
        return [scorers[score.__name__](case) for case in cases]

    monkeypatch.setattr(announce_study, "sweep", computed)
    monkeypatch.setattr(announce_study, "in_one_thread", lambda *_: 1.2)
    scored = announce_study.score_announce(AnnounceEffort(seconds=SECONDS, seeds=(1, 2)))
    assert {key: each[0].announced[0] for key, each in scored.errors.items()} == {
        0.005: pytest.approx(0.1),
        0.02: pytest.approx(0.2),
    }
    assert [each.announced[0] for each in scored.limit] == pytest.approx([0.3] * 6)
    assert [len(each.runs) for each in scored.errors[0.005]] == [2, 2, 2, 1, 1, 1]
    assert len(scored.faults) == 3
    assert [each.errors[-1] for each in scored.oracle[:2]] == pytest.approx([0.1, 0.2])
    assert len(scored.oracle) == 3 * 2 + 3


def test_records_that_cannot_be_read_are_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "wfdb", None)
    with pytest.raises(SourceError, match=r"pip install 'telepulse\[ecg\]'"):
        annotated_leads(tmp_path)
