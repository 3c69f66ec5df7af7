"""Checks that hold for files of every format alike: rates, values, names, refusals."""

import struct
import sys
from pathlib import Path

import edfio
import numpy as np
import pyarrow
import pytest
from pyarrow import parquet
from scipy.io import wavfile

from protocol.errors import SourceError
from sensing_node.files.formats import open_signals
from sensing_node.files.grids import find_gaps
from sensing_node.sources.choice import record_table
from sensing_node.sources.recorded import RecordedSource, RecordingScene
from telepulse.recording import xdf_writer
from tests.support.signal_files import pulse_and_ecg, wfdb_record

PULSE = pulse_and_ecg()["ABP"]


def refusal(path: Path) -> str:
    """Return the one line by which a source refuses a file."""
    with pytest.raises(SourceError) as caught:
        RecordedSource(RecordingScene.model_validate(record_table(path)[0]), Path())
    assert "\n" not in str(caught.value)
    return str(caught.value)


@pytest.mark.parametrize("rate_hz", [0, -5, np.nan, 1e9, np.inf, 0.5])
def test_a_rate_beyond_the_limits_is_refused(tmp_path: Path, rate_hz: float) -> None:
    np.savez(tmp_path / "a.npz", **{"ABP": PULSE, "rate_hz": np.float64(rate_hz)})
    assert f"has a rate of {rate_hz:g} Hz; rates are 1 Hz to 100000 Hz" in refusal(
        tmp_path / "a.npz"
    )


@pytest.mark.parametrize(("title", "step"), [("t [s]", 2.0), ("t [us]", 2.0), ("t_s", 5.0)])
def test_a_rate_by_the_files_own_times_is_checked_too(
    tmp_path: Path, title: str, step: float
) -> None:
    rows = "".join(f"{n * step},{v}\n" for n, v in enumerate(PULSE))
    (tmp_path / "a.csv").write_text(f"{title},ABP\n{rows}", encoding="utf-8")
    assert "rates are 1 Hz to 100000 Hz" in refusal(tmp_path / "a.csv")
    arrays = {title.replace("t [us]", "t_us"): np.arange(1000) * step, "ABP": PULSE}
    parquet.write_table(pyarrow.table(arrays), tmp_path / "a.parquet")
    assert "rates are 1 Hz to 100000 Hz" in refusal(tmp_path / "a.parquet")


def _xdf(path: Path, button_s: list[float]) -> Path:
    with path.open("wb") as file:
        head = b"<info><version>1.0</version></info>"
        file.write(xdf_writer.MAGIC + xdf_writer._chunk(xdf_writer.FILE_HEADER, head))
        streams = [("ABP", 250.0, (np.arange(1000) / 250).tolist(), PULSE.tolist()),
                   ("Button", 0.0, button_s, [1.0] * len(button_s))]  # fmt: skip
        for number, (name, rate_hz, times_s, values) in enumerate(streams, 1):
            labels = f"<channels><channel><label>{name}</label></channel></channels>"
            file.write(xdf_writer._header(number, name, "x", rate_hz, "double64", labels))
            rows = b"".join(
                struct.pack("<Bdd", 8, *each) for each in zip(times_s, values, strict=True)
            )
            file.write(xdf_writer._samples(number, len(times_s), rows))
            file.write(xdf_writer._end(number, times_s[0], times_s[-1], len(times_s)))
    return path


@pytest.mark.parametrize("button_s", [[1.0], [2.0, 2.0], [1.0, 2.5, 3.9]])
def test_an_irregular_stream_is_left_out_unless_it_is_asked_for(
    tmp_path: Path, button_s: list[float]
) -> None:
    path = _xdf(tmp_path / "a.xdf", button_s)
    file = open_signals(path)
    assert [signal.name for signal in file.signals] == ["ABP"]
    (note,) = file.notes
    assert note.startswith("left out: signal 'Button' has")
    assert record_table(path)[0]["column"] == 0
    with pytest.raises(SourceError, match="signal 'Button' has"):
        record_table(path, "Button")
    with pytest.raises(SourceError, match="signal 'Button' has"):
        file.load(("Button",))


def test_a_slow_signal_of_an_edf_is_left_out_unless_it_is_asked_for(tmp_path: Path) -> None:
    path = tmp_path / "a.edf"
    fast = edfio.EdfSignal(PULSE, 250, label="ABP", physical_dimension="mmHg")
    slow = edfio.EdfSignal(np.array([96.0, 97.0]), 0.5, label="SpO2", physical_dimension="%")
    edfio.Edf([slow, fast], data_record_duration=2).write(path)
    file = open_signals(path)
    assert [(signal.number, signal.name) for signal in file.signals] == [(1, "ABP")]
    text = "signal 'SpO2' has a rate of 0.5 Hz; rates are 1 Hz to 100000 Hz"
    assert file.notes == (f"left out: {text}",)
    for key in ("SpO2", "0"):
        with pytest.raises(SourceError, match=r"has a rate of 0\.5 Hz"):
            record_table(path, key)
    edfio.Edf([slow], data_record_duration=2).write(path)
    assert refusal(path) == f"{path}: {text}"


def test_a_signal_without_a_range_is_left_out_of_an_edf(tmp_path: Path) -> None:
    path = tmp_path / "a.edf"
    signals = [edfio.EdfSignal(PULSE, 250, label=label, physical_range=(0, 200))
               for label in ("ABP", "Status")]  # fmt: skip
    edfio.Edf(signals).write(path)
    data = path.read_bytes()
    # The second signal's greatest value becomes its least one.
    at = 256 + 2 * (16 + 80 + 8 + 8) + 8
    assert data[at : at + 8] == b"200     "
    path.write_bytes(data[:at] + b"0       " + data[at + 8 :])
    file = open_signals(path)
    assert [signal.name for signal in file.signals] == ["ABP"]
    assert file.notes[0].startswith("left out: signal 'Status' has the range (0.0, 0.0) for")


@pytest.mark.parametrize("source", ["npz", "csv", "parquet", "wav"])
def test_values_that_are_not_finite_are_missing_samples(tmp_path: Path, source: str) -> None:
    values = PULSE.copy()
    values[[5, 90]], values[7] = np.inf, np.nan
    path = tmp_path / f"in.{source}"
    if source == "npz":
        np.savez(path, **{"ABP [mmHg]": values, "rate_hz": 250.0})
    elif source == "parquet":
        columns = {"t_s": np.arange(1000) / 250, "ABP [mmHg]": values}
        parquet.write_table(pyarrow.table(columns), path)
    elif source == "wav":
        wavfile.write(path, 250, values)
    else:
        rows = "".join(f"{n / 250},{v}\n" for n, v in enumerate(values))
        path.write_text("t [s],ABP [mmHg]\n" + rows, encoding="utf-8")
    source_of = RecordedSource(RecordingScene.model_validate(record_table(path)[0]), Path())
    assert "3 samples are missing (0.3 %) in 3 gaps" in source_of.warnings[0]
    (column,) = open_signals(path).load((0 if source in ("npz", "wav") else 1,))
    assert find_gaps(column.values).samples == 3


def test_names_that_could_control_a_terminal_are_cleaned(tmp_path: Path) -> None:
    rows = "".join(f"{n / 250},{v},{n % 7}\n" for n, v in enumerate(PULSE))
    (tmp_path / "a.csv").write_text(f"t [s],ABP\x1b[31m [mmHg],x\x07y\n{rows}", encoding="utf-8")
    _, text = record_table(tmp_path / "a.csv")
    lines = [text]
    (tmp_path / "b.csv").write_text(f"\x1b[31mno\n{rows}".replace(",", ";"), encoding="utf-8")
    with pytest.raises(SourceError) as caught:
        open_signals(tmp_path / "a.csv").load(("no",))
    lines.append(str(caught.value))
    assert all(line.isprintable() for line in lines)


def test_an_xdf_file_that_breaks_off_says_so(tmp_path: Path) -> None:
    data = _xdf(tmp_path / "a.xdf", [1.0]).read_bytes()
    (tmp_path / "cut.xdf").write_bytes(data[: len(data) // 2])
    with pytest.raises(SourceError):
        open_signals(tmp_path / "cut.xdf")
    (tmp_path / "no_end.xdf").write_bytes(data[: data.rindex(b"<info><first_timestamp>") - 11])
    assert open_signals(tmp_path / "no_end.xdf").notes[0].endswith("no end: the file breaks off")


def _nothing(path: Path) -> Path:
    path.write_bytes(b"")
    return path


def test_refusals_name_file_fault_and_remedy_without_internals(tmp_path: Path) -> None:
    found = {}
    for suffix in ("csv", "npy", "npz", "hea", "edf", "xdf", "mcap", "parquet", "wav"):
        found[suffix] = refusal(_nothing(tmp_path / f"a.{suffix}"))
    assert set(found.values()) == {f"{tmp_path / f'a.{suffix}'}: is empty" for suffix in found}
    parquet.write_table(pyarrow.table({"a": ["x"]}), tmp_path / "b.parquet")
    assert refusal(tmp_path / "b.parquet").endswith(": holds no signal of numbers")
    np.savez(tmp_path / "b.npz")
    assert refusal(tmp_path / "b.npz").endswith(": holds no signal of numbers")
    (tmp_path / "b.npy").write_text("hello", encoding="utf-8")
    assert refusal(tmp_path / "b.npy").endswith("save it by numpy.save or numpy.savez")
    (tmp_path / "b.hea").write_text("# a comment\n", encoding="utf-8")
    assert refusal(tmp_path / "b.hea").endswith("header of a WFDB record: it holds no line")


@pytest.mark.parametrize(
    ("suffix", "library", "package"),
    [("edf", "edfio", "edfio"), ("xdf", "pyxdf", "'telepulse[files]'")],
)
def test_a_library_that_is_missing_is_named_with_what_installs_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, suffix: str, library: str, package: str
) -> None:
    monkeypatch.delitem(sys.modules, f"sensing_node.files.{suffix}", raising=False)
    monkeypatch.setitem(sys.modules, library, None)
    (tmp_path / f"a.{suffix}").write_bytes(b"0")
    line = refusal(tmp_path / f"a.{suffix}")
    assert f"needs {library}, which cannot be loaded" in line
    assert line.endswith(f"pip install {package}")


def test_units_beyond_ascii_are_read(tmp_path: Path) -> None:
    # Headers of others may be in Latin-1.
    record = wfdb_record(tmp_path, {"ABP": PULSE}).with_suffix(".hea")
    record.write_bytes(record.read_text(encoding="utf-8").replace("mmHg", "µN").encode("latin-1"))
    assert open_signals(record).signals[0].unit == "µN"
    record.write_bytes(record.read_bytes().decode("latin-1").encode("utf-8"))
    assert open_signals(record).signals[0].unit == "µN"


def test_a_wav_of_a_sound_card_is_refused_by_its_rate(tmp_path: Path) -> None:
    wavfile.write(tmp_path / "a.wav", 192_000, PULSE.astype("f4"))
    assert "has a rate of 192000 Hz" in refusal(tmp_path / "a.wav")
