"""Readers of files of signals, against files that other libraries wrote, and damaged ones."""

import random
from pathlib import Path
from typing import Any

import edfio
import numpy as np
import pyarrow
import pytest
from pyarrow import parquet
from scipy.io import wavfile

from protocol.errors import SourceError
from sensing_node.files.formats import open_signals
from sensing_node.files.grids import fill_gaps, find_gaps, on_grid
from sensing_node.files.signals import SignalFile
from tests.support.refusals import refusal_of
from tests.support.signal_files import Floats, pulse_and_ecg, wfdb_record

SIGNALS = pulse_and_ecg()


def samples(file: SignalFile) -> dict[str, Floats]:
    """Return all samples of a file by the signals' names."""
    return {column.name: column.values for column in file.load([s.name for s in file.signals])}


def test_a_record_by_hand_has_units_rate_and_gaps(tmp_path: Path) -> None:
    written = {**SIGNALS, "ABP": SIGNALS["ABP"].copy()}
    written["ABP"][[3, 4, 5, 900]] = np.nan
    path = wfdb_record(tmp_path, written)
    for name in (path, path.with_suffix(".hea"), path.with_suffix(".dat")):
        file = open_signals(name)
        assert [(s.name, s.unit, s.rate_hz, s.samples) for s in file.signals] == [
            ("II", "mV", 250.0, 1000),
            ("ABP", "mmHg", 250.0, 1000),
            ("RESP", "V", 250.0, 1000),
        ]
    read = samples(file)
    for name, values in written.items():
        np.testing.assert_allclose(read[name], values, atol=0.006)
    assert find_gaps(read["ABP"]) == (4, 2, 3)


# The package wfdb uses pandas in ways that pandas deprecates.
@pytest.mark.filterwarnings("ignore:The inplace keyword")
@pytest.mark.parametrize("code", ["16", "24", "32", "61", "80", "160", "212"])
def test_records_of_the_package_wfdb_are_read_to_the_last_bit(tmp_path: Path, code: str) -> None:
    wfdb = pytest.importorskip("wfdb", reason="the package wfdb is not installed")
    table = np.stack(list(SIGNALS.values()), axis=1)[:997]
    table[10:20, 1] = np.nan
    # The package does not write the other two formats of 16 bits.
    fmt = "16" if code in ("61", "160") else code
    wfdb.wrsamp("w", fs=250, units=["mV", "mmHg", "V"], sig_name=list(SIGNALS), p_signal=table,
                fmt=[fmt] * 3, write_dir=str(tmp_path))  # fmt: skip
    if code != fmt:
        dat, header = tmp_path / "w.dat", tmp_path / "w.hea"
        codes = np.fromfile(dat, "<i2")
        offset = (codes.astype(int) + 32768).astype("<u2")
        (codes.astype(">i2") if code == "61" else offset).tofile(dat)
        header.write_text(
            header.read_text(encoding="utf-8").replace("w.dat 16", f"w.dat {code}"),
            encoding="utf-8",
        )
    expected, _ = wfdb.rdsamp(str(tmp_path / "w"))
    read = np.stack(list(samples(open_signals(tmp_path / "w")).values()), axis=1)
    np.testing.assert_array_equal(read, expected)
    assert np.isnan(read).sum() == 10


def test_segments_are_joined_and_what_lies_between_is_missing(tmp_path: Path) -> None:
    for name, part in (("a", slice(0, 300)), ("b", slice(300, 500))):
        wfdb_record(tmp_path, {key: v[part] for key, v in SIGNALS.items()}, name=name)
    (tmp_path / "all.hea").write_text("all/3 3 250 600\na 300\n~ 100\nb 200\n", encoding="utf-8")
    read = samples(open_signals(tmp_path / "all"))["ABP"]
    np.testing.assert_allclose(read[:300], SIGNALS["ABP"][:300], atol=0.006)
    np.testing.assert_allclose(read[400:], SIGNALS["ABP"][300:500], atol=0.006)
    assert np.all(np.isnan(read[300:400]))


@pytest.mark.parametrize("kind", ["edf", "bdf"])
def test_edf_and_bdf_of_another_library_are_read(tmp_path: Path, kind: str) -> None:
    signal = edfio.BdfSignal if kind == "bdf" else edfio.EdfSignal
    keys: dict[str, Any] = {} if kind == "edf" else {"digital_range": (-8388608, 8388607)}
    signals = [
        signal(SIGNALS["II"], 250, label="II", physical_dimension="mV", **keys),
        signal(SIGNALS["ABP"][::2], 125, label="ABP", physical_dimension="mmHg", **keys),
    ]
    whole = edfio.Bdf if kind == "bdf" else edfio.Edf
    notes = [edfio.EdfAnnotation(1.5, None, "cuff")]
    whole(signals, annotations=notes).write(tmp_path / f"e.{kind}")
    file = open_signals(tmp_path / f"e.{kind}")
    assert [(s.name, s.unit, s.rate_hz) for s in file.signals] == [
        ("II", "mV", 250.0),
        ("ABP", "mmHg", 125.0),
    ]
    path = tmp_path / f"e.{kind}"
    reread: Any = edfio.read_bdf(path) if kind == "bdf" else edfio.read_edf(path)
    for one, values in zip(reread.signals, samples(file).values(), strict=True):
        np.testing.assert_allclose(values, one.data, rtol=1e-9, atol=1e-9)


def test_a_discontinuous_edf_gets_its_gap_back(tmp_path: Path) -> None:
    path = tmp_path / "e.edf"
    signal = edfio.EdfSignal(SIGNALS["ABP"], 250, label="ABP")
    edfio.Edf([signal], annotations=[edfio.EdfAnnotation(0, None, "x")]).write(path)
    data = path.read_bytes().replace(b"EDF+C", b"EDF+D")
    for second in (3, 2):
        data = data.replace(b"+%d\x14\x14" % second, b"+%d\x14\x14" % (second + 2))
    path.write_bytes(data)
    read = samples(open_signals(path))["ABP"]
    assert find_gaps(read) == (500, 1, 500)
    np.testing.assert_allclose(read[1000:], SIGNALS["ABP"][500:], atol=0.01)


@pytest.mark.parametrize("length", [b"9999    ", b"        ", b"x"])
def test_an_edf_with_a_wrong_length_of_its_header_is_read(tmp_path: Path, length: bytes) -> None:
    path = _edf(tmp_path)
    before, data = samples(open_signals(path)), path.read_bytes()
    path.write_bytes(data[:184] + length + data[184 + len(length) :])
    np.testing.assert_array_equal(samples(open_signals(path))["ABP"], before["ABP"])


@pytest.mark.parametrize(("stated", "held"), [(b"-1", 4), (b"9", 4), (b"3", 3)])
def test_an_edf_whose_number_of_records_is_wrong_is_read(
    tmp_path: Path, stated: bytes, held: int
) -> None:
    path = _edf(tmp_path)
    data = path.read_bytes()
    path.write_bytes(data[:236] + stated.ljust(8) + data[244 : -3 if held == 4 else None])
    file = open_signals(path)
    held -= held == 4
    assert len(samples(file)["ABP"]) == 250 * held
    note = f"the header states 9 records, and the file holds {held}"
    assert file.notes == ((note,) if stated == b"9" else ())


@pytest.mark.parametrize("kind", ["i2", "i4", "f4", "u1"])
def test_wav_files_are_scaled_to_one(tmp_path: Path, kind: str) -> None:
    one = SIGNALS["II"] / 2
    full = {"i2": 32767, "i4": 2**31 - 1, "f4": 1, "u1": 127}[kind]
    codes = (one * full + (128 if kind == "u1" else 0)).astype(kind)
    wavfile.write(tmp_path / "w.wav", 250, np.stack([codes, codes], axis=1))
    file = open_signals(tmp_path / "w.wav")
    assert [(s.name, s.rate_hz) for s in file.signals] == [("channel 0", 250), ("channel 1", 250)]
    np.testing.assert_allclose(samples(file)["channel 1"], one, atol=0.01)


def _edf(folder: Path) -> Path:
    signal = edfio.EdfSignal(SIGNALS["ABP"], 250, label="ABP", physical_dimension="mmHg")
    edfio.Edf([signal], annotations=[edfio.EdfAnnotation(1, None, "x")]).write(folder / "a.edf")
    return folder / "a.edf"


# The other formats are damaged in tests/system/hostile.
@pytest.mark.parametrize("kind", ["wfdb", "parquet"])
def test_a_damaged_file_is_read_or_refused_in_one_line(tmp_path: Path, kind: str) -> None:
    path = tmp_path / "a.parquet"
    if kind == "wfdb":
        path = wfdb_record(tmp_path, SIGNALS).with_suffix(".hea")
    else:
        parquet.write_table(pyarrow.table(SIGNALS), path)
    data = path.read_bytes()
    rng = random.Random(1)
    head = min(len(data), 600)
    cuts = [data[:length] for length in sorted(rng.sample(range(len(data)), 20))]
    flips = []
    for _ in range(150):
        changed = bytearray(data)
        changed[rng.randrange(head)] = rng.choice(b"\0\xff-0919/ \n")
        flips.append(bytes(changed))
    lines = []
    for damaged in [b"", *cuts, *flips]:
        path.write_bytes(damaged)
        try:
            samples(open_signals(path))
        except SourceError as error:
            lines.append(str(error))
    assert len(lines) > 5
    assert all(line.startswith(str(tmp_path)) and "\n" not in line for line in lines)


HEADER = "rec 1 250 1000\nrec.dat 16 100/mmHg 16 0 0 0 0 ABP\n"


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("250", "nan", "signal 'ABP' has a rate of nan Hz"),
        ("rec 1 ", "rec 0 ", "its files hold no whole sample"),
        ("rec 1 ", "rec 7 ", "its first line announces 7 lines, and 1 follow"),
        ("rec 1 ", "rec 999999999999 ", "its first line announces 999999999999 lines"),
        ("rec 1 ", "rec x ", "is no header of a WFDB record"),
        ("16 100", "516 100", "is stored in format 516; formats 16, 61"),
        ("16 100", "16x99999 100", "its files hold no whole sample"),
        ("16 100", "16x0 100", "rec.dat has no samples in a frame"),
        ("rec.dat", "../rec.dat", "names '../rec.dat', which is not in its own folder"),
        ("rec.dat", "gone.dat", "its file gone.dat is missing"),
        ("100/mmHg", "x/mmHg", "'x/mmHg' is no gain"),
    ],
)
def test_a_wrong_header_is_named(tmp_path: Path, old: str, new: str, message: str) -> None:
    path = wfdb_record(tmp_path, {"ABP": SIGNALS["ABP"]}).with_suffix(".hea")
    path.write_text(HEADER.replace(old, new, 1), encoding="utf-8")
    assert message in refusal_of(SourceError, lambda: samples(open_signals(path)))


def test_a_record_cut_short_says_what_is_missing(tmp_path: Path) -> None:
    path = wfdb_record(tmp_path, SIGNALS)
    dat = path.with_suffix(".dat")
    dat.write_bytes(dat.read_bytes()[:3001])
    file = open_signals(path)
    assert file.notes == ("the header states 1000 samples, and the files hold 500; the rest is"
                          " missing",)  # fmt: skip
    assert len(samples(file)["ABP"]) == 500


def test_times_become_a_grid_with_gaps_and_may_not_fall() -> None:
    t_s = np.array([0.0, 0.0101, 0.0199, 0.05])
    grid = on_grid(t_s, np.arange(4.0), 100.0, Path("x"))
    np.testing.assert_array_equal(grid, [0, 1, 2, np.nan, np.nan, 3])
    np.testing.assert_allclose(fill_gaps(grid), [0, 1, 2, 2 + 1 / 3, 2 + 2 / 3, 3], rtol=1e-12)
    with pytest.raises(SourceError, match="the times fall at sample 2"):
        on_grid(np.array([0.0, 2.0, 1.0]), np.arange(3.0), 1.0, Path("x"))
    with pytest.raises(SourceError, match="its times are damaged"):
        on_grid(np.array([0.0, 1e12]), np.arange(2.0), 1.0, Path("x"))
