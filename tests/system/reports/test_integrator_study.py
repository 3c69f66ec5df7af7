import sys

import pytest

from telepulse.document import Report
from telepulse.parallel import in_one_thread
from telepulse.reports.studies.integrator_report import NOT_INSTALLED, report_integrators
from telepulse.reports.studies.integrator_scores import (
    CONTROL,
    DEFAULT,
    IntegratorEffort,
    score_integrators,
)

LITTLE = IntegratorEffort(
    seconds=0.3, rounds=1, substeps=(1, 2), solvers=(("RK45", 1e-6),), rotor_seconds=0.2
)
LEAST = IntegratorEffort(seconds=0.02, rounds=1, substeps=(1,), solvers=(), rotor_seconds=0.01)


@pytest.fixture(scope="module")
def report() -> Report:
    return report_integrators(in_one_thread(score_integrators, LITTLE), LITTLE)


def rows(report: Report, chapter: int, table: int) -> dict[str, tuple[str, ...]]:
    return {row[0]: row[1:] for row in report.chapters[chapter].tables[table].rows}


def test_every_integrator_of_the_question_has_a_row(report: Report) -> None:
    assert list(rows(report, 0, 0)) == [
        DEFAULT,
        "RK4 × 1",
        "RK4 × 2",
        "semi-implicit Euler × 1",
        "semi-implicit Euler × 2",
        "explicit Euler × 1",
        "explicit Euler × 2",
        "solve_ivp RK45 rtol 1e-06",
        "scipy lsim",
        CONTROL,
    ]


def test_the_exact_ones_are_at_rounding_and_the_others_are_not(report: Report) -> None:
    errors = {name: float(cells[0]) for name, cells in rows(report, 0, 0).items()}
    for name in (DEFAULT, "scipy lsim", CONTROL):
        assert errors[name] < 1e-14
    assert 1e-14 < errors["RK4 × 1"] < 1e-11
    for family in ("semi-implicit Euler", "explicit Euler"):
        assert 1e-5 < errors[f"{family} × 2"] < errors[f"{family} × 1"] < 0.1


def test_the_reference_is_good_to_1e_12(report: Report) -> None:
    checks = rows(report, 0, 1)
    assert len(checks) == 2
    for (difference,) in checks.values():
        assert 0 < float(difference) < 1e-12


def test_the_sentence_on_the_default_agrees_with_its_row(report: Report) -> None:
    *_, frontier = rows(report, 0, 0)[DEFAULT]
    sentence = report.chapters[0].findings[0]
    assert (frontier == "yes") == ("is on the frontier" in sentence)


def test_the_findings_have_the_errors_the_rotor_and_the_check(report: Report) -> None:
    error, cost, *_ = rows(report, 0, 0)[DEFAULT]
    findings = report.findings
    assert 4 <= len(findings) <= 5
    assert f"Its largest error is {error} of the pulse" in findings[1]
    assert f"{cost} µs a step" in findings[1]
    assert any(" by RK4 × 1, at " in each and "times the cost" in each for each in findings)
    assert any("On a resonant rotor" in each and "explicit Euler × 1" in each for each in findings)
    assert findings[-1].startswith("The reference agrees with its two checks")


def test_on_a_rotor_the_exact_stays_exact_and_explicit_euler_grows(report: Report) -> None:
    for table in (0, 1):
        errors = rows(report, 1, table)
        for name in (DEFAULT, "scipy lsim", CONTROL):
            assert all(float(cell) < 1e-12 for cell in errors[name])
        assert errors["explicit Euler × 1"][1:] == ("grows", "grows")
        assert errors["RK4 × 1"][2] == "grows"
        assert float(errors["semi-implicit Euler × 1"][1]) < 1
        assert all(float(cell) < 1e-3 for cell in errors["solve_ivp RK45 rtol 1e-06"])


def test_without_python_control_its_row_names_the_extra(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "control", None)
    without = report_integrators(score_integrators(LEAST), LEAST)
    named = [name for name in rows(without, 0, 0) if name.startswith(CONTROL)]
    assert named == [f"{CONTROL}: {NOT_INSTALLED}"]
    assert "pip install 'telepulse[bench]'" in NOT_INSTALLED
    assert CONTROL not in rows(without, 1, 0)
