"""Checks that hold for files of every format alike: rates, values, names, refusals."""

import struct
from pathlib import Path

import numpy as np
import pyarrow
import pytest
from pyarrow import parquet
from scipy.io import wavfile

from protocol.errors import SourceError
from sensing_node.files.formats import open_signals
from sensing_node.files.grids import find_gaps
from sensing_node.files.signal_choice import record_table
from sensing_node.sources.recorded import RecordedSource, RecordingScene
from telepulse.recording import xdf_writer
from tests.support.refusals import refusal_of
from tests.support.signal_files import pulse_and_ecg

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
    lines.append(refusal_of(SourceError, lambda: open_signals(tmp_path / "a.csv").load(("no",))))
    assert all(line.isprintable() for line in lines)


def test_an_xdf_file_that_breaks_off_says_so(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, capfd: pytest.CaptureFixture[str]
) -> None:
    caplog.set_level("DEBUG")
    data = _xdf(tmp_path / "a.xdf", [1.0]).read_bytes()
    (tmp_path / "cut.xdf").write_bytes(data[: len(data) // 2])
    with pytest.raises(SourceError):
        open_signals(tmp_path / "cut.xdf")
    (tmp_path / "no_end.xdf").write_bytes(data[: data.rindex(b"<info><first_timestamp>") - 11])
    assert open_signals(tmp_path / "no_end.xdf").notes[0].endswith("no end: the file breaks off")
    # The lines of the library do not reach the screen.
    assert (caplog.records, tuple(capfd.readouterr())) == ([], ("", ""))
