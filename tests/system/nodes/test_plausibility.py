"""Checks of a source when it is opened, and while it runs."""

import datetime
import itertools
import math
import socket
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from protocol.config.scene import validate
from protocol.errors import SceneError
from sensing_node.sources.plausibility import SampleCheck
from sensing_node.sources.recorded import RecordedSource, RecordingScene
from telepulse.scene import load_scene
from telepulse.simulation.virtual_time import simulate
from tests.support.nodes import RADIAL, free_address, read_json, run
from tests.support.recording_files import recording, refusal, table
from tests.support.streams import MS, synthetic

RATE_HZ = 100
TIMES_S = np.arange(1000) / RATE_HZ
PULSE_N = synthetic(rate="100 Hz", peak_to_peak="0.3 N", preload="0.3 N").take(1000)[:, 0]


def csv(folder: Path, **columns: object) -> Path:
    path = folder / "pulse.csv"
    rows = zip(*columns.values(), strict=True)  # type: ignore[call-overload]
    lines = [",".join(columns), *(",".join(map(str, row)) for row in rows)]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path


def warnings(path: Path, **keys: object) -> list[str]:
    return [line.removeprefix(f"{path}: ") for line in recording(path, **keys).warnings]


def test_a_recording_of_a_pulse_is_neither_refused_nor_warned_of(tmp_path: Path) -> None:
    assert warnings(csv(tmp_path, time=TIMES_S, force=PULSE_N), column="force") == []
    assert warnings(csv(tmp_path, force=PULSE_N * 1e3), unit="mN") == []


@pytest.mark.parametrize(
    ("factor", "keys", "said"),
    [
        (1e3, {"unit": "N"}, 'reaches 516.4 N in unit "N", and a pulse stays below 20 N; set unit'),
        (
            -1e3,
            {"unit": "N"},
            'reaches 516.4 N in unit "N", and a pulse stays below 20 N; set unit',
        ),
        (1e3, {"unit": "V", "film_radius": "9 mm"}, "if it is in that"),
        (1e9, {"unit": "N"}, 'set unit, or unit = "raw" with peak_to_peak'),
        (1e3, {"unit": "V", "sensitivity": "44 mV/N"}, 'set unit = "mV", if it is in that'),
    ],
)
def test_a_recording_in_the_wrong_unit_is_refused(
    tmp_path: Path, factor: float, keys: dict[str, str], said: str
) -> None:
    assert said in refusal(csv(tmp_path, force=PULSE_N * factor), **keys)


def test_a_pulse_that_nobody_feels_is_warned_of(tmp_path: Path) -> None:
    (warning,) = warnings(csv(tmp_path, force=PULSE_N), unit="mN")
    assert warning == 'is 0.3 mN from peak to peak, which nobody feels: is unit = "N" right?'


def test_a_raw_recording_rests_on_the_preload_of_a_synthetic_one(tmp_path: Path) -> None:
    path = csv(tmp_path, adc=np.round(PULSE_N * 1e3 + 2000))
    force_n = recording(path, unit="raw", peak_to_peak="0.3 N").take(1000)
    assert force_n.mean() == pytest.approx(0.3)
    assert force_n.min() > 0.1
    # One that is set counts.
    keys = {"unit": "raw", "peak_to_peak": "0.3 N", "preload": "0.2 N"}
    assert recording(path, **keys).take(1000).mean() == pytest.approx(0.2)


def test_a_pulse_below_zero_is_refused_with_the_preload_that_it_needs(tmp_path: Path) -> None:
    path = csv(tmp_path, force=PULSE_N - PULSE_N.mean())
    text = refusal(path)
    assert text.startswith("is below 0 N for 57 %")
    assert text.endswith('of the samples, which no display can play; set preload = "0.1 N" or more')
    assert recording(path, preload="0.1 N").take(1000).min() > -1e-3
    half = refusal(path, unit="raw", peak_to_peak="0.3 N", preload="0 N")
    assert "which no display can play" in half


def test_a_pulse_that_dips_below_zero_is_warned_of(tmp_path: Path) -> None:
    force_n = PULSE_N.copy()
    force_n[:50] = -0.02
    (warning,) = warnings(csv(tmp_path, force=force_n))
    assert warning == (
        'is below 0 N for 5 % of the samples, which are not played; preload = "0.05 N" prevents it'
    )


def test_a_recording_that_an_adc_has_cut_is_warned_of(tmp_path: Path) -> None:
    whole = np.round(PULSE_N * 1e3)
    assert warnings(csv(tmp_path, adc=whole), unit="mN") == []
    (warning,) = warnings(csv(tmp_path, adc=np.minimum(whole, 400)), unit="mN")
    assert warning.startswith("is at its highest value for 1")
    assert warning.endswith("% of the samples: was it recorded beyond an ADC's range?")


def test_a_pulse_that_pulls_is_refused_and_can_be_inverted(tmp_path: Path) -> None:
    path = csv(tmp_path, force=-PULSE_N)
    assert "set inverted = true" in refusal(path)
    np.testing.assert_allclose(recording(path, inverted=True).take(1000)[:, 0], PULSE_N)
    keys = {"unit": "raw", "peak_to_peak": "0.3 N", "inverted": True}
    raw_n = recording(path, **keys).take(1000)[:, 0]
    assert np.corrcoef(raw_n, PULSE_N)[0, 1] > 0.999


@pytest.mark.parametrize(
    ("columns", "said"),
    [
        (
            {"time": TIMES_S, "force": PULSE_N},
            'column 0 ("time") only ever rises, as time does and',
        ),
        ({"t": TIMES_S // 0.02, "i": TIMES_S, "adc": PULSE_N}, 'set column = "adc", or the one'),
        ({"time": TIMES_S}, 'column 0 ("time") only ever rises, as time does and no pulse'),
    ],
)
def test_a_column_of_times_is_refused_and_the_force_named(
    tmp_path: Path, columns: dict[str, NDArray[Any]], said: str
) -> None:
    assert said in refusal(csv(tmp_path, **columns))


def test_a_column_of_times_in_a_numpy_table_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "pulse.npy"
    np.save(path, np.column_stack([TIMES_S, PULSE_N]))
    assert refusal(path) == (
        "column 0 only ever rises, as time does and no pulse; set column to the one with the force"
    )
    assert warnings(path, column=1) == []
    assert 'set rate = "100 Hz"' in refusal(path, column=1, rate="250 Hz")


BEGIN = datetime.datetime(2016, 11, 24, 13, 58, 58, tzinfo=datetime.UTC)
DATES = [(BEGIN + datetime.timedelta(seconds=float(t))).isoformat() for t in TIMES_S]


@pytest.mark.parametrize(
    ("name", "times"),
    [
        ("time", TIMES_S),
        ("t (ms)", TIMES_S * 1e3),
        ("timestamp_us", TIMES_S * 1e6 + 1.7e15),
        ("elapsed", TIMES_S + 5),
        ("time", np.floor(TIMES_S)),
        ("datetime", DATES),
    ],
)
def test_the_scenes_rate_is_compared_with_the_files_own_times(
    tmp_path: Path, name: str, times: object
) -> None:
    path = csv(tmp_path, **{name: times, "force": PULSE_N})
    assert warnings(path, column="force") == []
    text = refusal(path, column="force", rate="500 Hz")
    assert text.startswith(f'column "{name}" has 1')
    assert "the scene's rate is 500 Hz; set rate = \"" in text


@pytest.mark.parametrize(
    "beside",
    [
        np.arange(1000),  # The numbers of the samples.
        np.zeros(1000),
        np.arange(1000) // 250,  # The numbers of trials.
        np.cumsum(np.random.default_rng(1).exponential(size=1000)),
        np.random.default_rng(1).normal(size=1000),
    ],
)
def test_what_stands_beside_and_is_no_time_says_nothing_of_the_rate(
    tmp_path: Path, beside: NDArray[np.float64]
) -> None:
    path = csv(tmp_path, beside=beside, force=PULSE_N)
    assert warnings(path, column="force", rate="37 Hz") == []


@pytest.mark.parametrize(
    "times",
    [
        np.append(TIMES_S[:-1], math.inf),
        np.arange(1000) * 5e-324,
        np.arange(1000) * 1e305,
        np.full(1000, math.nan),
    ],
)
def test_times_that_are_no_times_are_passed_over(
    tmp_path: Path, times: NDArray[np.float64]
) -> None:
    assert warnings(csv(tmp_path, time=times, force=PULSE_N), column="force") == []
    np.savez(tmp_path / "pulse.npz", time=times, force=PULSE_N)
    assert warnings(tmp_path / "pulse.npz", column="force") == []


def test_gaps_in_the_files_own_times_are_warned_of(tmp_path: Path) -> None:
    times_s = TIMES_S + 3.0 * (TIMES_S > 2) + 60.0 * (TIMES_S > 7)
    (warning,) = warnings(csv(tmp_path, time=times_s, force=PULSE_N), column="force")
    assert warning.startswith(
        'column "time" has 2 gaps; what comes after one is played right after'
    )


@pytest.mark.parametrize("keys", [{}, {"unit": "raw", "peak_to_peak": "0.3 N"}])
def test_equal_values_are_refused_in_every_unit(tmp_path: Path, keys: dict[str, str]) -> None:
    path = csv(tmp_path, force=np.full(100, 0.3))
    assert refusal(path, **keys) == 'column 0 ("force"): all values are equal, 0.3; it has no pulse'


@pytest.mark.parametrize(
    ("keys", "said"),
    [
        ({"peak_to_peak": "0.3 N"}, 'peak_to_peak is for unit raw, not "N"'),
        ({"film_radius": "9 mm"}, 'film_radius is for unit V or mV, not "N"'),
        ({"unit": "V"}, "needs film_radius or sensitivity"),
        ({"unit": "V", "film_radius": "9 mm", "sensitivity": "1 V/N"}, "give one of them"),
    ],
)
def test_a_key_that_would_be_passed_over_is_refused(keys: dict[str, str], said: str) -> None:
    with pytest.raises(SceneError) as caught:
        validate(table(Path("pulse.csv"), **keys), RecordingScene, "[sensing] source")
    assert said in str(caught.value)


def test_samples_that_cannot_be_a_pulses_are_counted_and_reported_once(logged: list[str]) -> None:
    check = SampleCheck(MS)
    check.add(np.full((5, 1), 0.3) + np.arange(5)[:, np.newaxis] * 1e-3)
    assert (check.faults(), logged) == ([], [])
    for number in range(600):
        check.add(np.array([[300.0 + number], [301.0], [math.nan], [0.3], [-0.2]]))
    assert logged == [
        "3 samples beyond 20 N, which no pulse reaches: check unit and scale in [sensing.source]",
        "399 samples (20 %) below 0 N, which no display can play: set a higher preload in"
        " [sensing.source], or check the sign",
    ]
    assert [fault.split(",")[0] for fault in check.faults()] == [
        "1800 samples beyond 20 N",
        "600 samples (20 %) below 0 N",
    ]


def test_a_sensor_that_stands_still_is_reported_once(logged: list[str]) -> None:
    check = SampleCheck(MS)
    for force_n in itertools.chain([0.1, 0.2], itertools.repeat(0.3, 1600), [0.4]):
        check.add(np.full((5, 1), force_n))
    assert logged == ["the force did not change for 5.0 s: check the sensor"]
    assert check.faults() == ["the force did not change for 8.0 s: check the sensor"]


def test_a_synthetic_pulse_without_a_preload_is_told_by_the_simulation(tmp_path: Path) -> None:
    path = tmp_path / "light.toml"
    path.write_text(RADIAL.read_text("utf-8").replace('preload = "0.3 N"', 'preload = "0 N"'))
    summary = simulate(load_scene(path), seconds=5, seed=1)
    (fault,) = summary.faults
    assert "below 0 N, which no display can play: set a higher preload" in fault
    assert summary.limited.negative.share is not None
    assert summary.limited.negative.share > 0.4


def scene_of(folder: Path, source: dict[str, object]) -> Path:
    lines = [f"{key} = {f'{value!r}'}" for key, value in source.items()]
    path = folder / "scene.toml"
    path.write_text("\n".join(["[sensing.source]", *lines]) + "\n", encoding="utf-8")
    return path


@pytest.mark.parametrize("force_n", [np.full(100, 1e3), np.tile([-1e29, 1e29], 50), TIMES_S])
def test_an_emulated_board_sends_what_no_wrist_does(
    tmp_path: Path, force_n: NDArray[np.float64]
) -> None:
    """Emulators make the boards that a real sensing node must stand."""
    path = csv(tmp_path, force=force_n)
    scene = validate(table(path), RecordingScene, "[sensing] source")
    source = RecordedSource(scene, tmp_path, plausible=False)
    assert len(source.warnings) == 1
    np.testing.assert_array_equal(source.take(100)[:, 0], force_n[:100])


def test_a_sensing_node_refuses_the_wrong_unit_in_one_line(tmp_path: Path) -> None:
    path = csv(tmp_path, force=PULSE_N * 1e3)
    result = run("sensing_node.cli", str(scene_of(tmp_path, table(path))))
    assert (result.returncode, result.stdout) == (2, "")
    assert result.stderr == (
        f'sensing-node: {path}: reaches 516.4 N in unit "N", and a pulse stays below 20 N;'
        ' set unit = "mN", if it is in that\n'
    )


@contextmanager
def board(lines: list[str]) -> Iterator[int]:
    """A sensor on a network port that repeats its lines, 200 a second; its port."""
    stop = threading.Event()
    with socket.create_server(("127.0.0.1", 0)) as server:
        server.settimeout(0.2)

        def serve() -> None:
            while not stop.is_set():
                try:
                    connection, _ = server.accept()
                except TimeoutError:
                    continue
                with connection:
                    for line in itertools.cycle(lines):
                        if stop.wait(5e-3):
                            break
                        try:
                            connection.sendall(f"{line}\n".encode())
                        except OSError:
                            break

        thread = threading.Thread(target=serve)
        thread.start()
        try:
            yield server.getsockname()[1]
        finally:
            stop.set()
            thread.join()


def test_a_live_sensor_in_the_wrong_unit_is_counted_and_reported_once(tmp_path: Path) -> None:
    out = tmp_path / "summary.json"
    with board([f"{300 + i}" for i in range(50)]) as port:
        url = f"socket://127.0.0.1:{port}"
        keys = {"kind": "serial", "port": url, "framing": "text", "rate": "200 Hz", "unit": "N"}
        arguments = ("--bind", free_address(), "--seconds", "2", "--json", str(out))
        result = run("sensing_node.cli", str(scene_of(tmp_path, keys)), *arguments)
    assert result.returncode == 0, result.stderr
    printed = " ".join(result.stderr.split())
    assert printed.count("beyond 20 N, which no pulse reaches") == 1
    assert "beyond 20 N, which no pulse reaches: check unit and scale in" in printed
    summary = read_json(out)
    count = summary["samples"]["sent"]
    assert f"{count} samples beyond 20 N" in "; ".join(summary["faults"])
