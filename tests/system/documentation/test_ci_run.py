"""The commands of .ci/run that no other test runs."""

import re
import sys

import pytest

from tests.machines.__main__ import main
from tests.support.nodes import ROOT


def test_the_machines_of_ci_are_chosen_by_options_that_exist(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    script = (ROOT / ".ci" / "run").read_text(encoding="utf-8")
    (options,) = re.findall(r'^make machines ARGS="(.*)"$', script, re.M)
    monkeypatch.setattr(sys, "argv", ["machines", *options.split(), "--list"])
    assert main() == 0
    assert "lowest" in capsys.readouterr().out
