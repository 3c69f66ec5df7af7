"""A wrong argument of the Python API is one line that names it; numbers of numpy are right ones."""

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import telepulse
from protocol.errors import AddressError, ArgumentError, SceneError, SourceError

# Wrong on purpose: a type checker would refuse most of them.
api: Any = telepulse
ADDRESS = "tcp://127.0.0.1:5555"
WAVE = np.zeros(100)
RUN = api.simulate("radial", seconds=0.5, display={"predictor": "linear"})
CASES: list[tuple[Callable[[], object], type[Exception], str]] = [
    (lambda: api.simulate(None), ArgumentError, "scene: must be a name or .*, got None"),
    (lambda: api.load_scene(b"radial"), ArgumentError, "scene: must be .*, got b'radial'"),
    (lambda: api.simulate(seed="a"), ArgumentError, "seed: must be a whole number .*, got 'a'"),
    (lambda: api.simulate(seed=-1), ArgumentError, "seed: must be .* from 0 to .*, got -1"),
    (
        lambda: api.simulate(seed=1 << 63),
        ArgumentError,
        "seed: must be .*, got 9223372036854775808",
    ),
    (lambda: api.simulate(seconds="5"), ArgumentError, "seconds: must be a number .*, got '5'"),
    (lambda: api.simulate(seconds=math.nan), ArgumentError, "seconds: must be .*, got nan"),
    (lambda: api.simulate(seconds=math.inf), ArgumentError, "seconds: .* to 86400, got inf"),
    (lambda: api.simulate(display="predictor=linear"), ArgumentError, "display: must be a table"),
    (lambda: api.simulate(link=["delay=1ms"]), ArgumentError, "link: must be a table .* or a text"),
    (lambda: api.simulate(link={1: 2}), SceneError, r".*\[link\] 1: unknown key; known: delay"),
    (lambda: api.simulate(display={"film": {1: 2}}), SceneError, r".* film.1: unknown key; known"),
    (lambda: api.simulate(source=5), ArgumentError, "source: must be the path of a file, got 5"),
    (lambda: api.simulate(source="no.csv"), SourceError, "no.csv: no such recording"),
    (lambda: api.simulate(rate="5 Hz"), SceneError, "--rate is of a record; give the record by"),
    (
        lambda: api.simulate(api.load_scene(), source="no.csv"),
        SceneError,
        "changes of a scene that is loaded already: give them to load_scene",
    ),
    (lambda: api.connect(None), AddressError, "address: must be a text tcp.*, got None"),
    (lambda: api.connect(ADDRESS, key=5), ArgumentError, "key: must be the path of a file, got 5"),
    (lambda: api.read_recording(None), ArgumentError, "path: must be the path .*, got None"),
    (lambda: api.find_beats(WAVE, "5"), ArgumentError, "rate_hz: must be a number .*, got '5'"),
    (lambda: api.find_beats(["a"], 100), ArgumentError, "force_n: must be an array of numbers"),
    (lambda: api.find_beats(WAVE), ArgumentError, "rate_hz: give the samples a second, or their"),
    (lambda: api.find_beats(WAVE, 100, t_s=WAVE), ArgumentError, "rate_hz: give .*, not both"),
    (
        lambda: api.find_beats(WAVE, t_s=[1]),
        ArgumentError,
        "t_s: must have the 100 values",
    ),
    (lambda: api.find_beats(WAVE, t_s=WAVE), ArgumentError, "t_s: must be .* later than the one"),
    (
        lambda: api.find_beats(WAVE, t_s=np.arange(100)),
        ArgumentError,
        "t_s: samples a second: must be a number from 20 to 100000, got 1.0",
    ),
    (lambda: RUN.beats("force_n"), ArgumentError, "of: must be one of wrist_n, .*, got 'force_n'"),
    (lambda: RUN.beats(contactor="x"), ArgumentError, "contactor: must be one of 'channel 0', got"),
    (lambda: api.find_beats(RUN, 500), ArgumentError, "force_n: a Run states its rate; give no"),
    (lambda: api.sweep(math.sqrt, 5), ArgumentError, "cases: must be a list or .*, got 5"),
]


@pytest.mark.parametrize(("call", "error", "line"), CASES)
def test_a_wrong_argument_is_named_in_one_line(
    call: Callable[[], object], error: type[Exception], line: str
) -> None:
    with pytest.raises(telepulse.TelepulseError, match=f"^{line}") as caught:
        call()
    assert type(caught.value) is error
    assert isinstance(caught.value, ValueError | OSError)
    assert "\n" not in str(caught.value)


def test_numbers_of_numpy_are_numbers() -> None:
    run = telepulse.simulate("radial", np.float32(1), np.int64(3))
    expected = telepulse.simulate("radial", 1.0, 3)
    np.testing.assert_array_equal(run.felt_n, expected.felt_n)


def test_a_file_of_a_change_is_found_from_the_working_directory(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    wave = 1 + np.sin(np.arange(2_000) / 40)
    np.savetxt("pulse.csv", wave, header="light", comments="")
    source = {"kind": "recording", "path": "pulse.csv", "rate": "1 kHz", "column": "light"}
    change = {"source": source | {"unit": "raw", "peak_to_peak": "0.3 N"}}
    run = telepulse.simulate("radial", seconds=1, sensing=change)
    assert np.nanmax(run.wrist_n) - np.nanmin(run.wrist_n) == pytest.approx(0.3, rel=0.01)
    assert source["path"] == "pulse.csv"


def test_a_source_is_played_as_by_the_option_of_the_command(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    t_s = np.arange(0, 20, 0.01)
    near_n, far_n = 0.5 + 0.15 * np.sin(7.5 * t_s) ** 4, 1 + 0.3 * np.sin(5 * t_s) ** 4
    far_n[1000:1005] = np.nan
    columns = np.stack([t_s, near_n, far_n], axis=1)
    np.savetxt("pulse.csv", columns, "%.6f", ",", header="time_s,near_N,far_N", comments="")
    with pytest.raises(SourceError, match=r"near_N .*far_N .*name one: --channel$"):
        telepulse.simulate(source="pulse.csv")
    change = {"source": {"inverted": True}}
    for channel in ("far_N", 2):
        run = telepulse.simulate(
            seconds=12, source=Path("pulse.csv"), channel=channel, preload="2 N", sensing=change
        )
        assert run.name == "pulse"
        assert np.nanmin(run.wrist_n) == pytest.approx(2 - 1.3, abs=1e-3)
        assert any("5 samples are missing" in note.text for note in run.summary.notes)
    # Twice as fast, two beats become four.
    slow, fast = (
        telepulse.simulate(source="pulse.csv", channel="near_N", rate=rate, seconds=6)
        for rate in (None, "200 Hz")
    )
    assert slow.beats()[1].interval_s == pytest.approx(2 * fast.beats()[1].interval_s, rel=0.02)


def test_options_and_changes_of_the_display_both_hold() -> None:
    options = {"predictor": "linear", "announce": None}
    display = telepulse.load_scene("radial", options, display={"announce": "off"}).display
    assert (display.predictor.kind, display.announce) == ("linear", "off")
