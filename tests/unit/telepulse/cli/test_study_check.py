"""`--check` of a study: exit status 1 where a criterion is missed."""

from pathlib import Path

import pytest
import typer

from telepulse.cli.study import publish_checked
from telepulse.document import Chapter, Report


def report(finding: str) -> Report:
    return Report("A study", (Chapter("Scores", ("Words.",), findings=("It ran.", finding)),))


@pytest.mark.parametrize(
    ("finding", "check", "ends"),
    [
        ("Missed: the height.", True, True),
        ("Missed: the height.", False, False),
        ("All criteria are met.", True, False),
    ],
)
def test_a_missed_criterion_ends_with_status_1(
    tmp_path: Path, finding: str, check: bool, ends: bool
) -> None:
    if not ends:
        publish_checked(lambda: report(finding), tmp_path, None, check)
        return
    with pytest.raises(typer.Exit) as end:
        publish_checked(lambda: report(finding), tmp_path, None, check)
    assert end.value.exit_code == 1
    assert any(tmp_path.iterdir())
