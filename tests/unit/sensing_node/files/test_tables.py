"""Tables of CSV, NumPy and Parquet: layouts, times and columns that are no signals."""

from datetime import UTC, datetime, timedelta
from decimal import Decimal
from pathlib import Path

import numpy as np
import pyarrow
import pytest
from pyarrow import parquet

from protocol.errors import SourceError
from sensing_node.files.formats import open_signals
from sensing_node.files.grids import find_gaps
from sensing_node.sources.choice import record_table
from sensing_node.sources.recorded import RecordedSource, RecordingScene
from tests.support.signal_files import pulse_and_ecg

ABP = pulse_and_ecg()["ABP"]
TIMES_S = np.arange(1000) / 250
BEGIN = datetime(2024, 1, 1, tzinfo=UTC)


def played(path: Path) -> RecordedSource:
    return RecordedSource(RecordingScene.model_validate(record_table(path)[0]), Path())


def csv_file(path: Path, title: str, separator: str = ",", decimal: str = ".") -> Path:
    rows = [f"{t:.4f}{separator}{v:.4f}".replace(".", decimal)
            for t, v in zip(TIMES_S, ABP, strict=True)]  # fmt: skip
    path.write_text("\n".join([title, *rows, ""]), encoding="utf-8")
    return path


@pytest.mark.parametrize(
    "title",
    ["t", "Time (s)", "seconds", "sec", "elapsed [s]", "zeit [s]", "ts", "index", "x [s]"],
)
def test_times_are_found_by_their_title_or_since_they_rise(tmp_path: Path, title: str) -> None:
    path = csv_file(tmp_path / "a.csv", f"{title},ABP [mmHg]")
    assert "plays ABP (mmHg)" in record_table(path)[1]
    assert played(path).period_ns == 4_000_000


@pytest.mark.parametrize(
    ("separator", "decimal"), [(",", "."), (";", "."), (";", ","), ("\t", "."), ("\t", ","),
                               (" ", "."), (" ", ",")],
)  # fmt: skip
@pytest.mark.parametrize("suffix", ["csv", "txt"])
def test_separators_and_decimal_commas_are_recognised(
    tmp_path: Path, separator: str, decimal: str, suffix: str
) -> None:
    title = f"# by hand\n\nt{separator}ABP"
    path = csv_file(tmp_path / f"a.{suffix}", title, separator, decimal)
    assert [signal.name for signal in open_signals(path).signals] == ["t", "ABP"]
    (column,) = open_signals(path).load(("ABP",))
    np.testing.assert_allclose(column.values, ABP, atol=1e-4)
    assert played(path).period_ns == 4_000_000


def test_empty_cells_are_missing_samples_and_words_are_named_by_line(tmp_path: Path) -> None:
    path = csv_file(tmp_path / "a.csv", "# comment\nt,ABP")
    lines = path.read_text(encoding="utf-8").splitlines()
    lines[10] = lines[10].partition(",")[0] + ","
    path.write_text("\n".join(lines), encoding="utf-8")
    (column,) = open_signals(path).load(("ABP",))
    assert find_gaps(column.values).samples == 1
    lines[20] = "0.1,high"
    path.write_text("\n".join(lines), encoding="utf-8")
    with pytest.raises(SourceError, match=r"line 21, '0\.1,high': 'high' is not a number; write"):
        open_signals(path).load(("ABP",))


def test_dates_are_times(tmp_path: Path) -> None:
    # At 5 Hz, times without a unit would be taken as ms.
    dates = [BEGIN + timedelta(milliseconds=200 * n) for n in range(1000)]
    index, column = tmp_path / "index.parquet", tmp_path / "column.parquet"
    table = pyarrow.table({"ABP [mmHg]": ABP, "__index_level_0__": dates})
    parquet.write_table(table, index)
    parquet.write_table(pyarrow.table({"time": dates, "ABP [mmHg]": ABP}), column)
    text = tmp_path / "a.csv"
    rows = "".join(f"{at:%Y-%m-%dT%H:%M:%S.%f},{v}\n" for at, v in zip(dates, ABP, strict=True))
    text.write_text("time,ABP [mmHg]\n" + rows, encoding="utf-8")
    for path in (index, column, text):
        source = played(path)
        assert (source.period_ns, source.warnings) == (200_000_000, [])


def test_numbers_of_parquet_may_be_decimal_or_share_a_name(tmp_path: Path) -> None:
    decimals = [Decimal(f"{v:.3f}") for v in ABP]
    names = ["t_s", "ABP", "ABP", "note"]
    table = pyarrow.table([TIMES_S, decimals, ABP, ["x"] * 1000], names=names)
    parquet.write_table(table, tmp_path / "a.parquet")
    file = open_signals(tmp_path / "a.parquet")
    assert [signal.number for signal in file.signals] == [0, 1, 2]
    for column in file.load((1, 2)):
        np.testing.assert_allclose(column.values, ABP, atol=1e-3)


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


def test_a_table_without_rate_or_times_says_what_to_do(tmp_path: Path) -> None:
    np.save(tmp_path / "a.npy", ABP)
    with pytest.raises(SourceError, match=r'--rate "500 Hz" beside --source, rate = "500 Hz" in'):
        played(tmp_path / "a.npy")
    (tmp_path / "b.csv").write_text("t,ABP\n", encoding="utf-8")
    with pytest.raises(SourceError) as caught:
        played(tmp_path / "b.csv")
    assert "\n" not in str(caught.value)
