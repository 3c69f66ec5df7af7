"""Files as recorders write them: each is played as `expected.toml` beside it states."""

import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from protocol.config.scene_file import find_scene
from protocol.errors import SourceError
from sensing_node.files.formats import open_signals
from sensing_node.files.signal_choice import record_table
from sensing_node.scene import build_source, load_sensing
from sensing_node.sources.recorded import RecordedSource, RecordingScene
from tests.support.refusals import refusal_of
from tests.support.signal_files import beats_per_min

FIELD = Path(__file__).parents[3] / "data" / "field"
EXPECTED: dict[str, dict[str, Any]] = tomllib.loads((FIELD / "expected.toml").read_text("utf-8"))
# Rates that the files do not state, and lines that name what was changed in them.
RATES = dict.fromkeys(("arduino_equals", "two_kinds_of_rows", "text_behind"), "100 Hz")
NOTES = {
    "one_bad_time": ["1 time is not used, that in row 701 (line 702), 200007"],
    "millis_restart": ["was set back by 34880 after row 3000 (line 3001)"],
    "counter_by_14": ['column "Time" has the name of times, and falls or is no number'],
    "two_kinds_of_rows": ["its rows are of several kinds, each a signal: PPG, ACC"],
    "clock_set_back": ["was set back by 4 after row 1100 (line 1101)"],
}


@pytest.mark.parametrize("name", [name for name in EXPECTED if "asks" not in EXPECTED[name]])
def test_a_file_of_a_recorder_is_played_as_expected(
    name: str, caplog: pytest.LogCaptureFixture
) -> None:
    expected = EXPECTED[name]
    caplog.set_level("INFO")
    path = FIELD / expected["file"]
    sensing = load_sensing(find_scene("radial"), {"source": str(path), "rate": RATES.get(name)})
    source = build_source(sensing, Path())
    assert isinstance(source, RecordedSource)
    assert isinstance(sensing.source, RecordingScene)
    chosen, signals = sensing.source.column, open_signals(path).signals
    (signal,) = [each for each in signals if each.number == chosen]
    rate_hz = 1e9 / source.period_ns
    assert signal.name == expected.get("signal", "")
    assert signal.unit == expected.get("unit", "")
    assert rate_hz == pytest.approx(
        expected.get("rate_hz", 100), rel=0.05 if name == "millis_9hz" else 1e-6
    )
    others = ", ".join(expected.get("others", []))
    assert f"the file also has {others} (--channel)" in caplog.text or not others
    assert ("also has" in caplog.text) == bool(others)
    values = open_signals(path).load([signal.number])[0].values
    lasts = f"it lasts {len(values) / rate_hz:.4g} s"
    assert lasts in caplog.text
    force_n = source.take(len(values))[:, 0]
    if "heart_rate_per_min" in expected:
        assert beats_per_min(force_n, rate_hz) == pytest.approx(
            expected["heart_rate_per_min"], rel=0.01
        )
    if "lasts_s" in expected:
        assert len(values) / rate_hz == pytest.approx(expected["lasts_s"], rel=0.01)
    if "height_mn" in expected:
        assert np.ptp(force_n) * 1e3 == pytest.approx(expected["height_mn"], rel=0.03)
    wanted = NOTES.get(name, [])
    assert len(source.warnings) == len(wanted)
    assert all(note in line for note, line in zip(wanted, source.warnings, strict=True))


@pytest.mark.parametrize("name", [name for name in EXPECTED if "asks" in EXPECTED[name]])
def test_a_file_with_several_readings_is_refused_in_one_line(name: str) -> None:
    path = FIELD / EXPECTED[name]["file"]
    text = refusal_of(SourceError, lambda: record_table(path))
    assert "\n" not in text
    assert all(part in text for part in EXPECTED[name]["asks"])


def test_the_start_and_the_rate_of_a_wristband_are_no_samples() -> None:
    file = open_signals(FIELD / "e4_bvp.csv")
    values = file.load([0])[0].values
    assert (len(values), values.max() < 120) == (1920, True)
