"""Further forms of text that recorders, spreadsheets and sketches write, and refusals of others."""

from collections.abc import Callable
from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np
import pytest

from protocol.errors import SourceError
from sensing_node.files.formats import open_signals
from sensing_node.sources.choice import record_table
from sensing_node.sources.recorded import RecordedSource, RecordingScene
from tests.support.signal_files import pulse_and_ecg

PULSE = pulse_and_ecg(5.0, 200)["ABP"]
BEGIN = datetime(2024, 1, 31, 23, 59, 58, tzinfo=UTC)


def rows(row: Callable[[int], str]) -> str:
    return "\n".join(map(row, range(len(PULSE)))) + "\n"


def t(n: int) -> str:
    return f"{n / 200:.3f}"


def v(n: int, more: float = 0.0) -> str:
    return f"{PULSE[n] + more:.3f}"


def at(n: int, form: str) -> str:
    return f"{BEGIN + timedelta(milliseconds=5 * n):{form}}"[:-3]


def comma(text: str) -> str:
    """Return a number with a decimal comma, and points between thousands."""
    return text.replace(",", "_").replace(".", ",").replace("_", ".")


# Name of the signal, unit, and text.
PLAYED = {
    "quoted, decimal commas": ("Kraft", "mN", '"Zeit [ms]";"Kraft [mN]"\n'
        + rows(lambda n: f'"{n * 5},0";"{comma(v(n))}"')),
    "one column with decimal commas": ("Kraft", "mN", "fs = 200 Hz\nKraft / mN\n"
        + rows(lambda n: comma(v(n)))),
    "thousands and decimal commas": ("Kraft", "mN", "Zeit;Kraft\ns;mN\n"
        + rows(lambda n: f"{comma(t(n))};{comma(f'{PULSE[n] + 1000:,.1f}')}")),
    "tabs and units below": ("Force", "mN", "Time\tForce\ns\tmN\n"
        + rows(lambda n: f"{t(n)}\t{v(n)}")),
    "units in brackets": ("Force", "mN", "time (s),Force (mN)\n"
        + rows(lambda n: f"{t(n)},{v(n)}")),
    "titles after %": ("Force", "mN", "% fs = 200 Hz\n% Force [mN], ECG [mV]\n"
        + rows(lambda n: f"{v(n)}, {n % 7}")),
    "a title after #": ("force", "mN", "# t,force [mN]\n" + rows(lambda n: f"{t(n)},{v(n)}")),
    "the time between samples": ("force", "", "// Sampling interval: 5 ms\nforce\n"
        + rows(v)),
    "samples a second": ("force", "", "recorded at 200 samples/s\nforce\n" + rows(v)),
    "kHz": ("force", "", "Sample rate (kHz),0.2\nSubject,01\n\nforce\n" + rows(v)),
    "keys apart by commas": ("force", "", "Subject,01\nSampling rate,200 Hz\ntime,force\n"
        + rows(lambda n: f"{t(n)},{v(n)}")),
    "keys of columns": ("Pulse", "mmHg", "Interval=\t0.005 s\nChannelTitle=\tPulse\tECG\n"
        "Range=\t10.000 V\t10.000 V\nUnitName=\tmmHg\tmV\n"
        + rows(lambda n: f"{t(n)}\t{v(n)}\t{n % 7}")),
    "minutes, counts and a separator at the end": ("CH1", "", "rec.acq\n5 msec/sample\n2 channels\n"
        "min,CH1,CH2,\n,1000,1000,\n" + rows(lambda n: f"{n / 12000:.8f},{v(n)},{n % 7},")),
    "a table of PhysioNet with elapsed times": ("ABP", "mmHg",
        "'Elapsed time','ABP'\n'hh:mm:ss.mmm','mmHg'\n"
        + rows(lambda n: f"'0:0{n / 200:.3f}',{v(n)}")),
    "a fixed width": ("ABP", "mmHg", "# fs: 200\n   sample #      ABP    PLETH\n"
        "                (mmHg)     (NU)\n"
        + rows(lambda n: f"{n:10d} {PULSE[n]:8.3f} {PULSE[n] / 9:8.3f}")),
    "ISO times": ("ppg", "", "timestamp,ppg\n"
        + rows(lambda n: f"{at(n, '%Y-%m-%dT%H:%M:%S.%f')}Z,{v(n)}")),
    "German dates": ("Kraft", "mN", "Datum;Kraft/mN\n"
        + rows(lambda n: f"{at(n, '%d.%m.%Y %H:%M:%S,%f')};{comma(v(n))}")),
    "American dates": ("Pressure", "mmHg", "Date Time,Pressure (mmHg)\n"
        + rows(lambda n: f"{at(n, '%m/%d/%Y %H:%M:%S.%f')},{v(n)}")),
    "times of day over midnight": ("ppg", "", "date,clock,ppg\n"
        + rows(lambda n: f"{at(n, '%Y-%m-%d,%H:%M:%S.%f')},{v(n)}")),
    "ms since 1970": ("ppg", "", "n,ts,ppg\n"
        + rows(lambda n: f"{n},{1544027337000 + 5 * n},{v(n)}")),
    "labels with colons": ("IR", "", "Ready\n# fs: 200\n"
        + rows(lambda n: f"IR:{PULSE[n] * 1e3:.0f},RED:{PULSE[n] * 500:.0f}")),
    "labels after the time": ("IR", "", rows(lambda n: f"12:00:0{t(n)} -> IR={v(n)} RED=7 mV")),
    "tables of JSON": ("ppg", "", rows(lambda n: f'{{"t_ms": {n * 5}, "ppg": {v(n)}}}')),
    "bars": ("force", "", "time | force\n" + rows(lambda n: f"{t(n)} | {v(n)}")),
    "remarks": ("force", "", "who,time,force,event\n"
        + rows(lambda n: f"S01,{t(n)},{v(n)},{'start' if n == 600 else ''}")),
    "empty lines at the end": ("force", "", "time,force\n"
        + rows(lambda n: f"{t(n)},{v(n)}") + "\n\n,\n"),
    "ends of lines of an old Mac": ("force", "", "time,force\r"
        + rows(lambda n: f"{t(n)},{v(n)}").replace("\n", "\r")),
}  # fmt: skip


@pytest.mark.parametrize("form", PLAYED)
@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16", "utf-16-le"])
def test_a_form_of_text_is_played(tmp_path: Path, form: str, encoding: str) -> None:
    name, unit, text = PLAYED[form]
    path = tmp_path / "a.txt"
    path.write_bytes(text.encode(encoding))
    table, _ = record_table(path)
    source = RecordedSource(RecordingScene.model_validate(table), Path())
    file = open_signals(path)
    (signal,) = [each for each in file.signals if each.number == table["column"]]
    assert (signal.name, signal.unit) == (name, unit)
    assert source.period_ns == pytest.approx(5_000_000, rel=1e-6)
    assert source.warnings == []
    values = file.load([signal.number])[0].values
    assert len(values) == len(PULSE)
    assert np.corrcoef(values, PULSE)[0, 1] > 0.999


def test_wrong_times_are_replaced_and_named(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    lines = ["time,ppg", *rows(lambda n: f"{t(n)},{v(n)}").splitlines()]
    lines[1], lines[58] = f"x,{v(0)}", f"0.000,{v(57)}"
    path.write_text("\n".join(lines))
    source = RecordedSource(RecordingScene.model_validate(record_table(path)[0]), Path())
    (warning,) = source.warnings
    assert warning.endswith("2 times are not used, the first in row 1 (line 2), 'x'")
    assert source.period_ns == 5_000_000
    (column,) = open_signals(path).load(["ppg"])
    np.testing.assert_allclose(column.rising["time"], np.arange(len(PULSE)) / 200, atol=1e-9)


def test_a_last_line_that_breaks_off_is_left_out_and_named(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    path.write_text("time,ppg\n" + rows(lambda n: f"{t(n)},{v(n)}") + "5.0")
    source = RecordedSource(RecordingScene.model_validate(record_table(path)[0]), Path())
    (warning,) = source.warnings
    assert warning.endswith("line 1002, the last one, breaks off, and is left out")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("Hello world\nno table\n", "holds no signal of numbers: line 1, 'Hello world', is no row"),
        ("t [s],n\n" + rows(lambda n: f"{t(n)},{n % 16}"), "holds no pulse: t has times, n counts"),
        ("t [s],n,flat\n" + rows(lambda n: f"{t(n)},{n % 16},7"),
         'column 2 ("flat"): all values are equal, 7; it has no pulse'),
        ("t [s],clock\n" + rows(lambda n: f"{t(n)},{n}"), "column 1 (\"clock\") never falls"),
        ("time,ppg\n" + rows(lambda n: f"{t(n)},{v(n)}") + "time,ppg\n0,1\n",
         "line 1002, 'time,ppg': 'ppg' is not a number; write one there or nothing"),
        ("\0" * 200_000, r"line 1, '\x00\x00"),
    ],
)  # fmt: skip
def test_a_refusal_quotes_the_first_line_that_does_not_fit(
    tmp_path: Path, text: str, message: str
) -> None:
    path = tmp_path / "a.csv"
    path.write_text(text)
    with pytest.raises(SourceError) as caught:
        RecordedSource(RecordingScene.model_validate(record_table(path)[0]), Path())
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)
