from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pytest

from tests.support.recording_files import csv_file, recording, refusal
from tests.support.streams import synthetic

TIMES_S = np.arange(1000) / 100
PULSE_N = synthetic(rate="100 Hz", peak_to_peak="0.3 N", preload="0.3 N").take(1000)[:, 0]
DIPPING_N = np.where(np.arange(1000) < 50, -0.02, PULSE_N)
COUNTS = np.round(PULSE_N * 1e3)
RAW = {"unit": "raw", "peak_to_peak": "0.3 N"}
FORCE = {"column": "force"}
Keys = Mapping[str, object]


def warnings(path: Path, **keys: object) -> list[str]:
    return [line.removeprefix(f"{path}: ") for line in recording(path, **keys).warnings]


@pytest.mark.parametrize(
    ("columns", "keys"),
    [
        ({"time": TIMES_S, "force": PULSE_N}, FORCE),
        ({"force": PULSE_N * 1e3}, {"unit": "mN"}),
        ({"adc": COUNTS}, {"unit": "mN"}),
        ({"force": PULSE_N - PULSE_N.mean()}, {"preload": "0.1 N"}),
        ({"force": -PULSE_N}, {"inverted": True}),
        # Other columns that are no times: numbers of samples or trials, random numbers.
        *(
            ({"other": other, "force": PULSE_N}, {**FORCE, "rate": "37 Hz"})
            for other in (
                np.arange(1000),
                np.zeros(1000),
                np.arange(1000) // 250,
                np.cumsum(np.random.default_rng(1).exponential(size=1000)),
                np.random.default_rng(1).normal(size=1000),
            )
        ),
    ],
)
def test_a_plausible_recording_has_no_warning(tmp_path: Path, columns: Keys, keys: Keys) -> None:
    assert warnings(csv_file(tmp_path, columns), **keys) == []


ABOVE = 'reaches 516.4 N in unit "N", and a pulse stays below 20 N; set unit'
ONLY_RISES = "never falls, so it is a time and not a pulse"


@pytest.mark.parametrize(
    ("columns", "keys", "text"),
    [
        ({"force": PULSE_N * 1e3}, {}, f'{ABOVE} = "mN" if the values are in mN'),
        ({"force": PULSE_N * 1e3}, {"unit": "V", "film_radius": "9 mm"}, "if the values are in mV"),
        (
            {"force": PULSE_N - PULSE_N.mean()},
            {},
            "is below 0 N for 57 % of the samples, which no display can play;"
            ' set preload = "0.1 N" or more',
        ),
        ({"force": PULSE_N}, {**RAW, "preload": "0 N"}, "which no display can play"),
        ({"force": -PULSE_N}, {}, "set inverted = true"),
        ({"time": TIMES_S, "force": PULSE_N}, {"column": 0}, f'column 0 ("time") {ONLY_RISES}'),
        *(
            (
                {"force": np.full(100, 0.3)},
                keys,
                'column 0 ("force"): all values are equal, 0.3; it has no pulse',
            )
            for keys in ({}, RAW)
        ),
    ],
)  # fmt: skip
def test_a_recording_that_cannot_be_a_pulse_is_refused(
    tmp_path: Path, columns: Keys, keys: Keys, text: str
) -> None:
    assert text in refusal(csv_file(tmp_path, columns), **keys)


@pytest.mark.parametrize(
    ("columns", "keys", "text"),
    [
        ({"force": PULSE_N}, {"unit": "mN"},
         'is 0.3 mN from peak to peak, too small to feel: is unit = "N" right?'),
        (
            {"force": DIPPING_N},
            {},
            "is below 0 N for 5 % of the samples, which are not played;"
            ' preload = "0.05 N" (beside --source: --preload) prevents it',
        ),
        (
            {"adc": np.minimum(COUNTS, 400)},
            {"unit": "mN"},
            "is at its highest value for 13 % of the samples: was it recorded beyond an ADC's"
            " range?",
        ),
        (
            {"time": TIMES_S + 3.0 * (TIMES_S > 2) + 60.0 * (TIMES_S > 7), "force": PULSE_N},
            FORCE,
            'column "time" has 2 gaps; samples after a gap are played right after'
            " those before it",
        ),
    ],
)  # fmt: skip
def test_a_doubtful_recording_has_a_warning(
    tmp_path: Path, columns: Keys, keys: Keys, text: str
) -> None:
    assert warnings(csv_file(tmp_path, columns), **keys) == [text]
