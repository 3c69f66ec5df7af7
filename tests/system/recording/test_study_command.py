"""`telepulse study record` states what it did to the recording, and draws a plot with titles."""

import json
import re
from pathlib import Path

import numpy as np

from tests.support.nodes import run_python

LINK = "delay=20ms"


def test_filled_gaps_are_stated_as_by_simulate_and_the_plot_has_titles(tmp_path: Path) -> None:
    t_s = np.arange(0, 24, 0.01)
    rows = [f"{0.5 + 0.15 * np.sin(7.5 * at_s) ** 4:.5f}" for at_s in t_s]
    rows[1000:1005] = [""] * 5
    lines = [f"{at_s:.2f},{row}" for at_s, row in zip(t_s, rows, strict=True)]
    (tmp_path / "$pulse$.csv").write_text("\n".join(["time_s,force_N", *lines, ""]))

    def run(*words: str) -> str:
        done = run_python("-m", "telepulse", *words, "--link", LINK, cwd=tmp_path, timeout=100)
        assert done.returncode == 0, done.stderr
        return " ".join(done.stdout.split())

    gaps = re.compile(r"The sensing node: \S*\$pulse\$\.csv: .*: 5 samples are missing .*them\.")
    simulated = gaps.search(run("simulate", "--source", "$pulse$.csv", "--seconds", "5"))
    files = ("--plot", "plot.svg", "--json", "study.json")
    studied = gaps.search(run("study", "record", "$pulse$.csv", "--seconds", "20", *files))
    assert simulated is not None
    assert studied is not None
    assert studied[0].startswith(simulated[0])
    (note,) = json.loads((tmp_path / "study.json").read_text())["notes"]
    assert (note["part"], "5 samples are missing" in note["text"]) == ("sensor", True)
    # The letters are drawn as paths, after a comment with their text.
    drawn = (tmp_path / "plot.svg").read_text()
    for title in ("$pulse$.csv over delay=20ms", "Felt at the finger", "Prediction ahead of"):
        assert f"<!-- {title}" in drawn
