import math
import os
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.support.recording_files import csv_file, recording, refusal

NUMBERS = [0.25, 1.5, 3.0, 2.0]
ARCHIVE = {"time": np.arange(4), "force": np.array(NUMBERS)}


def played(path: Path, **keys: object) -> list[float]:
    """Return all samples of a recording."""
    taken = recording(path, repeat="once", **keys).take(100)
    assert taken.shape[1] == 1
    return list(taken[:, 0])


def pulse_file(folder: Path, content: object = NUMBERS) -> Path:
    """Write text or bytes as CSV, a table of arrays as a NumPy archive, else a NumPy array."""
    path = folder / "pulse.npy"
    match content:
        case str() | bytes():
            path = folder / "pulse.csv"
            path.write_bytes(content.encode() if isinstance(content, str) else content)
        case dict():
            path = folder / "pulse.npz"
            np.savez(path, **content)
        case _:
            np.save(path, np.array(content), allow_pickle=True)
    return path


@pytest.mark.parametrize(
    ("content", "keys"),
    [
        ("0.25\n1.5\n3\n2\n", {}),
        ("force\n0.25\n1.5\n3\n2\n", {"column": "force"}),
        ("time,force\n0,0.25\n1,1.5\n2,3\n3,2\n\n\n", {"column": 1}),
        ('"a, b","2024"\n0,"0.25"\n1,"1.5"\n2,3\n3,2\n', {"column": "2024"}),
        ("2016-11-24 13:58:58,0.25\n2016-11-24 13:58:59,1.5\nnoon,3\n,2e0\n", {"column": 1}),
        *((np.array(NUMBERS, dtype), {}) for dtype in ("f8", "f4", ">f8", "f2")),
        (ARCHIVE, {"column": "force"}),
        (ARCHIVE, {"column": 1}),
        (ARCHIVE | {"text": np.array("x"), "more": np.zeros(9)}, {"column": 1}),
        ("Kraft [µN]\n0.25\n1.5\n3\n2\n".encode("latin-1"), {"column": "Kraft"}),
        ("# by hand\n\ntime;force\n0;0,25\n1;1,5\n# pause\n2;3\n3;2,0\n", {"column": "force"}),
        (" 0   0.25\n 1   1.5 \n 2 3\n3 2\n", {"column": 1}),
        # The pulse presses where the values fall.
        ([-number for number in NUMBERS], {"inverted": True}),
    ],
)
def test_a_column_is_played(tmp_path: Path, content: object, keys: dict[str, object]) -> None:
    assert played(pulse_file(tmp_path, content), **keys) == NUMBERS
    if isinstance(content, str):
        # A byte order mark is ignored.
        assert played(pulse_file(tmp_path, "\ufeff" + content), **keys) == NUMBERS


@pytest.mark.parametrize(
    ("keys", "newtons_per_number"),
    [
        ({"unit": "N"}, 1.0),
        ({"unit": "mN"}, 1e-3),
        # Eq 21: F = 2 π r V / (g31 + g32), g31 = g32 = 0.15 V·m/N.
        ({"unit": "V", "film_radius": "8 mm"}, 2 * math.pi * 8e-3 / 0.3),
        ({"unit": "mV", "film_radius": "9 mm"}, 2 * math.pi * 9e-3 / 0.3 * 1e-3),
    ],
)
def test_units_are_converted_to_newtons_with_the_preload_added(
    tmp_path: Path, keys: dict[str, str], newtons_per_number: float
) -> None:
    path = pulse_file(tmp_path)
    plain = [newtons_per_number * number for number in NUMBERS]
    assert played(path, **keys) == pytest.approx(plain)
    on_preload = played(path, preload="200 mN", **keys)
    assert on_preload == pytest.approx([force_n + 0.2 for force_n in plain])


@pytest.mark.parametrize(
    ("keys", "forces_n"),
    [
        ({"preload": "0.5 N"}, [0.3, 0.7, 0.4, 0.6]),
        # The default preload is that of a synthetic pulse.
        ({}, [0.1, 0.5, 0.2, 0.4]),
        ({"inverted": True}, [0.5, 0.1, 0.4, 0.2]),
    ],
)
def test_raw_values_are_scaled_to_peak_to_peak_and_preload(
    tmp_path: Path, keys: dict[str, object], forces_n: list[float]
) -> None:
    path = pulse_file(tmp_path, [100.0, 300.0, 150.0, 250.0])
    assert played(path, unit="raw", peak_to_peak="0.4 N", **keys) == pytest.approx(forces_n)


@pytest.mark.parametrize("counts", [[1] * 9, [9], [3, 6], [4, 4, 1], [2, 0, 7]])
def test_a_loop_repeats_the_samples(tmp_path: Path, counts: list[int]) -> None:
    source = recording(pulse_file(tmp_path))
    taken = np.concatenate([source.take(count) for count in counts])
    assert taken[:, 0].tolist() == [*NUMBERS, *NUMBERS, NUMBERS[0]]


def test_a_recording_that_is_played_once_ends_with_fewer_samples(tmp_path: Path) -> None:
    source = recording(pulse_file(tmp_path), repeat="once", rate="3 kHz")
    assert [len(source.take(3)) for _ in range(4)] == [3, 1, 0, 0]
    assert source.period_ns == 333_333


@pytest.mark.parametrize("suffix", ["csv", "npy", "npz"])
def test_a_missing_file_and_a_directory_are_refused(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"pulse.{suffix}"
    assert refusal(path) == "no such recording"
    path.mkdir()
    assert refusal(path) == f"cannot be read: {os.strerror(21)}"


REAL = "needs real numbers in one or two dimensions, has"
PROSE = "is no row of a table, which has numbers apart by commas, semicolons, tabs or spaces"
WORD = "is not a number; write one there or nothing"
FEW = "number of samples is {}; it must be 2 or more"


@pytest.mark.parametrize(
    ("content", "column", "message"),
    [
        ("time,force\n0,1\n1,2\n", "pressure", "no column 'pressure'; it has time, force"),
        ("0,1\n1,2\n", "force", "no column 'force'; it has 2"),
        ("time,force\n0,1\n1,2\n", 2, "no column 2; it has 2"),
        ("time,force\n0,1\n1\n2,3\n", 1, "line 3, '1': no column 1; it has 1"),
        ("time,force\n0,1\n1,high\n2,3\n", "force", f"line 3, '1,high': 'high' {WORD}"),
        ("1\n-inf\nnan\n1e31\n", 0,
         "1 value is beyond 1e+30, the first is sample 3; cut or fill them"),
        ("nan\nnan\n", 0, "all values are NaN"),
        ("", 0, "is empty"),
        ("\n# nothing\n", 0, "holds no line of values"),
        ("force\n", 0, f"holds no signal of numbers: line 1, 'force', {PROSE}"),
        ("force\n1\n", 0, FEW.format(1)),
        ("9" * 200_000, 0, f"line 1, '{'9' * 60}', has more than 131072 characters; a table of text"
                           " has a row in each line"),
        (np.zeros((4, 0)), 0, "holds no signal of numbers"),
        ([0.0], 0, FEW.format(1)),
        (1.0, 0, f"{REAL} float64 in 0"),
        (np.zeros((2, 2, 2)), 0, f"{REAL} float64 in 3"),
        (np.zeros(4, complex), 0, f"{REAL} complex128 in 1"),
        (["1", "2"], 0, f"{REAL} <U1 in 1"),
        ([1, None], 0, "holds Python objects in place of numbers; save an array of numbers"),
        (ARCHIVE, 2, "no column 2; it has 2"),
        (ARCHIVE | {"text": np.array("x")}, "text", "column 2, 'text', holds no numbers"),
    ],
)  # fmt: skip
def test_a_recording_that_cannot_be_used_is_refused(
    tmp_path: Path, content: object, column: int | str, message: str
) -> None:
    assert refusal(pulse_file(tmp_path, content), column=column) == message


FINGERS = {
    "time": np.arange(60) * 10,
    "cun": 0.3 + np.sin(np.arange(60)) / 10,
    "guan": 0.4 + np.cos(np.arange(60)) / 5,
    "II": np.sin(np.arange(60) / 2),
}


@pytest.mark.parametrize("kind", ["csv", "npz", "npy"])
def test_several_columns_are_channels_named_by_them(tmp_path: Path, kind: str) -> None:
    columns: list[str | int] = ["guan", "cun"]
    names, announce = ["guan", "cun"], 3 if kind == "npy" else "II"
    if kind == "csv":
        path = csv_file(tmp_path, FINGERS)
    elif kind == "npz":
        path = pulse_file(tmp_path, FINGERS)
    else:
        path = pulse_file(tmp_path, np.stack(list(FINGERS.values()), axis=1))
        columns, names = [2, 1], ["column 2", "column 1"]
    source = recording(path, columns=columns, announce=announce)
    channels = [(channel.name, channel.unit) for channel in source.channels]
    assert channels == [(name, "N") for name in names] + [("announce", "mV")]
    expected = np.stack([FINGERS["guan"], FINGERS["cun"], FINGERS["II"]], axis=1)
    np.testing.assert_array_equal(source.take(70), np.concatenate([expected, expected[:10]]))
    assert source.warnings == []
    # Numbers name the same columns, and the header names the channels.
    by_number = recording(path, columns=[2, 1], announce=3)
    assert by_number.channels == source.channels
    np.testing.assert_array_equal(by_number.take(60), expected)


@pytest.mark.parametrize(
    ("change", "keys", "message"),
    [
        ({}, {"columns": ["cun", "chi"]}, "no column 'chi'; it has time, cun, guan, II"),
        ({}, {"columns": ["cun", 4]}, "no column 4; it has 4"),
        ({}, {"columns": ["cun", 1]}, "column 1 is named twice; a column is one channel"),
        ({}, {"columns": ["cun"], "announce": 1}, "column 1 is named twice"),
        ({"guan": [0.3] * 60}, {}, 'column 2 ("guan"): all values are equal, 0.3'),
        ({"II": [0.3] * 60}, {"announce": "II"}, 'announce: column 3 ("II"): all values are equal'),
        (
            {"II": [0.0, 1e4] * 30},
            {"announce": "II", "announce_unit": "V"},
            'announce: column 3 ("II") reaches 1e+07 mV in unit "V"',
        ),
        ({"announce": FINGERS["cun"]}, {"columns": ["cun", "announce"]}, "columns: two channels"),
        ({"cun" * 99: FINGERS["cun"]}, {"columns": [1, 4]}, "columns: the name "),
    ],
)
def test_a_column_that_cannot_be_used_is_named(
    tmp_path: Path, change: dict[str, Any], keys: dict[str, Any], message: str
) -> None:
    path = csv_file(tmp_path, FINGERS | change)
    assert refusal(path, **{"columns": ["cun", "guan"]} | keys).startswith(message)
