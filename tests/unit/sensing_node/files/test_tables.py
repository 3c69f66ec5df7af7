"""Tables of CSV, NumPy and Parquet: layouts, times and columns that are no signals."""

from collections.abc import Callable
from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np
import pyarrow
import pytest
from pyarrow import parquet

from protocol.errors import SourceError
from sensing_node.files.formats import open_signals
from sensing_node.files.signal_choice import record_table
from sensing_node.sources.recorded import RecordedSource, RecordingScene
from tests.support.refusals import refusal_of
from tests.support.signal_files import pulse_and_ecg

ABP = pulse_and_ecg()["ABP"]
TIMES_S = np.arange(1000) / 250


def played(path: Path) -> RecordedSource:
    return RecordedSource(RecordingScene.model_validate(record_table(path)[0]), Path())


def csv_file(path: Path, title: str) -> Path:
    rows = [f"{t:.4f},{v:.4f}" for t, v in zip(TIMES_S, ABP, strict=True)]
    path.write_text("\n".join([title, *rows, ""]), encoding="utf-8")
    return path


@pytest.mark.parametrize(
    "title",
    ["t", "Time (s)", "seconds", "sec", "elapsed [s]", "zeit [s]", "ts", "index", "x [s]"],
)
def test_times_are_found_by_their_title_or_since_they_rise(tmp_path: Path, title: str) -> None:
    path = csv_file(tmp_path / "a.csv", f"{title},ABP [mmHg]")
    assert "plays ABP (mmHg, 250 Hz)" in record_table(path)[1]
    assert played(path).period_ns == 4_000_000


def test_dates_are_times(tmp_path: Path) -> None:
    abp = pulse_and_ecg(200.0, 5)["ABP"]
    dates = [BEGIN + timedelta(milliseconds=200 * n) for n in range(1000)]
    index, column = tmp_path / "index.parquet", tmp_path / "column.parquet"
    table = pyarrow.table({"ABP [mmHg]": abp, "__index_level_0__": dates})
    parquet.write_table(table, index)
    parquet.write_table(pyarrow.table({"time": dates, "ABP [mmHg]": abp}), column)
    for path in (index, column):
        source = played(path)
        assert (source.period_ns, source.warnings) == (200_000_000, [])


def test_only_arrays_of_numbers_are_signals(tmp_path: Path) -> None:
    np.savez(
        tmp_path / "a.npz",
        **{"about": np.array("by hand"), "fs": np.float64(3), "ABP": ABP, "II": ABP[:500]},
        labels=np.array(["a", "b"]),
        rate_hz=np.array([250.0]),
        object=np.array([object()]),
    )
    file = open_signals(tmp_path / "a.npz")
    assert [(each.name, each.rate_hz) for each in file.signals] == [("ABP", 250.0), ("II", 250.0)]
    assert file.notes == ("the array 'object' holds Python objects, and is left out",)
    assert played(tmp_path / "a.npz").period_ns == 4_000_000
    np.savez(tmp_path / "b.npz", **{"data[0] [N]": ABP, "data[1]": ABP, "rate_hz": 250.0})
    signals = open_signals(tmp_path / "b.npz").signals
    assert [(each.name, each.unit) for each in signals] == [("data[0]", "N"), ("data[1]", "")]


PULSE = pulse_and_ecg(5.0, 200)["ABP"]
NOISE = np.random.default_rng(1).integers(100, size=len(PULSE))
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
    "units in brackets": ("Force", "mN", "time (s),Force (mN)\n"
        + rows(lambda n: f"{t(n)},{v(n)}")),
    "titles after %": ("Force", "mN", "% fs = 200 Hz\n% Force [mN], ECG [mV]\n"
        + rows(lambda n: f"{v(n)}, {n % 7}")),
    "keys of columns": ("Pulse", "mmHg", "Interval=\t0.005 s\nChannelTitle=\tPulse\tECG\n"
        "Range=\t10.000 V\t10.000 V\nUnitName=\tmmHg\tmV\n"
        + rows(lambda n: f"{t(n)}\t{v(n)}\t{n % 7}")),
    "minutes, counts and a separator at the end": ("CH1", "", "rec.acq\n5 msec/sample\n2 channels\n"
        "min,CH1,CH2,\n,1000,1000,\n" + rows(lambda n: f"{n / 12000:.8f},{v(n)},{n % 7},")),
    "a fixed width": ("ABP", "mmHg", "# fs: 200\n   sample #      ABP    PLETH\n"
        "                (mmHg)     (NU)\n"
        + rows(lambda n: f"{n:10d} {PULSE[n]:8.3f} {PULSE[n] / 9:8.3f}")),
    "ISO times": ("ppg", "", "timestamp,ppg\n"
        + rows(lambda n: f"{at(n, '%Y-%m-%dT%H:%M:%S.%f')}Z,{v(n)}")),
    "German dates": ("Kraft", "mN", "Datum;Kraft/mN\n"
        + rows(lambda n: f"{at(n, '%d.%m.%Y %H:%M:%S,%f')};{comma(v(n))}")),
    "times of day over midnight": ("ppg", "", "date,clock,ppg\n"
        + rows(lambda n: f"{at(n, '%Y-%m-%d,%H:%M:%S.%f')},{v(n)}")),
    "ms since 1970": ("ppg", "", "n,ts,ppg\n"
        + rows(lambda n: f"{n},{1544027337000 + 5 * n},{v(n)}")),
    "labels with colons": ("IR", "", "Ready\n# fs: 200\n"
        + rows(lambda n: f"IR:{PULSE[n] * 1e3:.0f},RED:{PULSE[n] * 500:.0f}")),
    "tables of JSON": ("ppg", "", rows(lambda n: f'{{"t_ms": {n * 5}, "ppg": {v(n)}}}')),
    "units in cells": ("Kraft", "mN", "Zeit;Kraft\n" + rows(lambda n: f"{n * 5} ms;{v(n)} mN")),
    "units that change in cells": ("x", "mmHg", "t [s],x\n"
        + rows(lambda n: f"{t(n)},"
            + (f"{PULSE[n] * 133.322:.1f} Pa" if n % 3 == 2 else f"{v(n)} mmHg"))),
    "units in a column": ("value", "mV", "unit,value,time (s)\n"
        + rows(lambda n: f"mV,{v(n)},{t(n)}" if n < 600 else f"V,{PULSE[n] / 1e3:.6f},{t(n)}")),
    "a unit in a head line": ("load", "mN", "Load Units: mN\nms,load\n"
        + rows(lambda n: f"{n * 5},{v(n)}")),
    "names above units": ("PPG100C", "V", "rec.acq\n5 msec/sample\n2 channels\nPPG100C\nVolts\n"
        "RSP100C\nmV\nmin\tCH1\tCH2\t\n\t1000\t1000\t\n"
        + rows(lambda n: f"{n / 12000:.8f}\t{v(n)}\t{n % 7}\t")),
    "a name without a column": ("Force", "mN", "ms,Force [mN],Remark\n"
        + rows(lambda n: f"{n * 5},{v(n)}")),
    "kinds in a column": ("ppg x", "", "t_ms;sensor;x\n"
        + rows(lambda n: f"{n * 5};acc;{n % 3}\n{n * 5};ppg;{v(n)}")),
    "text behind labels": ("ir", "", "MAX ready, version 2\n# fs: 200\n"
        + rows(lambda n: f"ir: {v(n)}\tbpm: 71{' (no contact)' if n % 99 == 50 else ''}")),
    "a letter before each number": ("S", "", "# fs: 200\n" + rows(lambda n: f"S{v(n)}")),
    "a counter beside a rate": ("CH1", "", "Rate (S/s): 200\nrate: 200 Hz\nSequence,CH1\n"
        + rows(lambda n: f"{n * 10},{v(n)}")),
    "numbers of a monitor": ("ABP", "", "micros,HR,ABP_SYS,ABPMean,ABP,ppg_quality\n"
        + rows(lambda n: f"{n * 5000},{72 + n // 160 % 2},120,{90 + n // 160 % 3},{v(n)},{n % 2}")),
}  # fmt: skip
# Texts of refusals, and the text that has several readings.
ASKED = {
    "two pulses": (["a 75 /min, b 75 /min", "c no pulse", "--channel"], "t_ms,a,b,c\n"
        + rows(lambda n: f"{n * 5},{v(n)},{PULSE[n - 70]:.3f},{NOISE[n]}")),
    "no pulse": (["holds no pulse", "HR is a number", "x no pulse", "--channel"], "t_ms,HR,x\n"
        + rows(lambda n: f"{n * 5},{72 + n // 160 % 2},{NOISE[n]}")),
    "no unit of times": (["200 Hz if in ms", "--rate"], "time,force\n"
        + rows(lambda n: f"{n * 5},{NOISE[n]}")),
    "times against the head": (["states 100 Hz", "200 Hz", "--rate"], "fs: 100\nt_ms,force\n"
        + rows(lambda n: f"{n * 5},{v(n)}")),
    "units of two kinds": (["N, mmHg"], "t_ms,x,unit\n"
        + rows(lambda n: f"{n * 5},{v(n)},{'mmHg' if n % 5 else 'N'}")),
    "rows of two widths": (["1000 of 4 cells"],
        rows(lambda n: f"{n * 5},{v(n)}\n{n * 5},1,2,{n % 7}")),
    "labels of two kinds": (["PPG; ACC"], rows(lambda n: f"PPG:{v(n)}\nACC:{n % 7}")),
    "letters of two kinds": (["kinds: B; S"], rows(lambda n: f"B{n % 7}\nS{v(n)}")),
    "JSON of two kinds": (["type ppg", "type acc"],
        rows(lambda n: f'{{"v": {v(n)}, "type": "ppg"}}\n'
        f'{{"v": {n % 7}, "type": "acc"}}')),
    "JSON with lists": (["'v' of 2"], rows(lambda n: f'{{"t": {n}, "v": [{v(n)}, {n % 7}]}}')),
}  # fmt: skip


@pytest.mark.parametrize("form", ASKED)
def test_a_text_with_several_readings_is_refused(tmp_path: Path, form: str) -> None:
    parts, text = ASKED[form]
    (tmp_path / "a.log").write_text(text, encoding="utf-8")
    channel = "force" if "force" in text else None

    def played() -> RecordedSource:
        table, _ = record_table(tmp_path / "a.log", channel)
        return RecordedSource(RecordingScene.model_validate(table), Path())

    refusal = refusal_of(SourceError, played)
    assert "\n" not in refusal
    assert all(part in refusal for part in parts), refusal


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
    kinds = "its rows are of several kinds, each a signal: acc, ppg"
    assert [line.split(": ", 1)[1] for line in source.warnings] == [kinds] * (" " in name)
    values = file.load([signal.number])[0].values
    assert len(values) == len(PULSE)
    assert np.corrcoef(values, PULSE)[0, 1] > 0.999


def test_a_last_line_that_breaks_off_is_left_out_and_named(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    path.write_text("time,ppg\n" + rows(lambda n: f"{t(n)},{v(n)}") + "5.0")
    source = RecordedSource(RecordingScene.model_validate(record_table(path)[0]), Path())
    (warning,) = source.warnings
    assert warning.endswith("line 1002, the last one, breaks off, and is left out")


def test_rows_without_their_unit_are_missing_samples(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    unit = rows(lambda n: f"{t(n)},{v(n)},{'' if n == 7 else 'mN'}")
    path.write_text("time (s),x,unit\n" + unit + "5.000,90.0", encoding="utf-8")
    source = played(path)
    assert [line.split(": ", 1)[1] for line in source.warnings] == [
        'column 1 ("x"): 2 samples are missing (0.2 %) in 2 gaps, the longest of 0.005 s;'
        " straight lines replace them",
    ]


def test_kinds_of_rows_end_where_the_last_row_breaks_off(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    kinds = rows(lambda n: f"ppg,{n * 5},{v(n)}\nacc,{n * 5},{n % 3}")
    path.write_text("type,t_ms,x\n" + kinds + "pp", encoding="utf-8")
    assert "plays ppg x (no unit, 200 Hz)" in record_table(path)[1]
