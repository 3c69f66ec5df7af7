"""Conversions between formats: nothing is lost on the way, by our readers and by others'."""

import json
from pathlib import Path
from typing import Any

import edfio
import numpy as np
import pytest
import pyxdf
from mcap.writer import Writer
from pyarrow import parquet
from scipy.io import wavfile

from protocol.errors import OutputError, SourceError
from sensing_node.files.formats import open_signals, write_signals
from sensing_node.files.grids import find_gaps
from sensing_node.files.signals import SignalTable
from telepulse.recording.conversion import convert_file
from telepulse.recording.signal_export import export_signals
from tests.support.recordings import record
from tests.support.signal_files import Floats, pulse_and_ecg, wfdb_record

SIGNALS = pulse_and_ecg() | {"ABP": pulse_and_ecg()["ABP"]}
SIGNALS["ABP"][[100, 101, 500]] = np.nan
NAMES = list(SIGNALS)
# Steps of the record, and of 16 bits over its ranges.
STEP = {"II": 1e-3, "ABP": 0.02, "RESP": 1e-3}


@pytest.fixture
def source(tmp_path: Path) -> Path:
    return wfdb_record(tmp_path, SIGNALS)


def theirs(path: Path) -> dict[str, Floats]:
    """Return the samples of a file by another reader."""
    match path.suffix:
        case ".edf" | ".bdf":
            edf = (edfio.read_bdf if path.suffix == ".bdf" else edfio.read_edf)(path)
            return {s.label: np.where(s.digital == s.digital_min, np.nan, s.data)
                    for s in edf.signals}  # fmt: skip
        case ".xdf":
            streams, _ = pyxdf.load_xdf(str(path))
            assert [float(s["info"]["nominal_srate"][0]) for s in streams] == [250.0] * 3
            return {s["info"]["name"][0]: s["time_series"][:, 0] for s in streams}
        case ".parquet":
            table = parquet.read_table(path)
            assert table.schema.field("ABP").metadata[b"unit"] == b"mmHg"
            return {name: np.array(table[name].to_pylist(), float) for name in NAMES}
        case ".wav":
            rate_hz, data = wavfile.read(path)
            assert rate_hz == 250
            return dict(zip(NAMES, data.T, strict=True))
        case ".npz":
            with np.load(path) as loaded:
                return {name.partition(" [")[0]: loaded[name] for name in loaded}
        case ".hea":
            wfdb = pytest.importorskip("wfdb", reason="the package wfdb is not installed")
            values, fields = wfdb.rdsamp(str(path.with_suffix("")))
            assert (fields["fs"], fields["units"]) == (250, ["mV", "mmHg", "V"])
            return dict(zip(fields["sig_name"], values.T, strict=True))
        case _:
            rows = np.genfromtxt(path, delimiter=",", skip_header=1)
            return dict(zip(["t", *NAMES], rows.T, strict=True))


@pytest.mark.filterwarnings("ignore:The inplace keyword")
@pytest.mark.parametrize("suffix", ["hea", "edf", "bdf", "xdf", "parquet", "csv", "npz", "wav"])
def test_what_is_converted_is_read_back_by_us_and_by_others(
    source: Path, tmp_path: Path, suffix: str
) -> None:
    out = tmp_path / f"out.{suffix}"
    lines = list(convert_file(source, out))
    assert lines[1].endswith("3 samples are missing (0.3 %) in 2 gaps, the longest of 0.008 s")
    assert len(lines) == 4
    other = theirs(out)
    if suffix == "wav":
        assert "3 missing samples are replaced by straight lines" in lines[-1]
        np.testing.assert_allclose(other["RESP"], SIGNALS["RESP"], atol=1e-3)
        return
    again = open_signals(out)
    named = {signal.name: signal for signal in again.signals}
    for name, values in SIGNALS.items():
        unit = {"II": "mV", "ABP": "mmHg", "RESP": "V"}[name]
        assert named[name].unit == unit
        (ours,) = again.load((name,))
        np.testing.assert_allclose(ours.values, values, atol=STEP[name])
        np.testing.assert_allclose(other[name], ours.values, atol=STEP[name] * 1e-3)
    # The begin is kept where the format has one.
    if suffix in ("hea", "edf", "bdf"):
        assert again.begin_ns == open_signals(source).begin_ns
    back = list(convert_file(out, tmp_path / "back.hea"))
    assert len(back) == 4


def test_a_gap_in_a_tables_times_is_counted_and_a_clock_set_back_is_named(
    tmp_path: Path,
) -> None:
    path = tmp_path / "a.csv"
    times_s = np.arange(100) / 100 + 2.0 * (np.arange(100) >= 50)
    rows = [f"{t_s:.2f},{n % 9}" for n, t_s in enumerate(times_s)]
    path.write_text("\n".join(["t [s],force [N]", *rows]), encoding="utf-8")
    first, _ = convert_file(path, tmp_path / "b.csv")
    assert first.endswith(
        "force, N, 100 Hz, 3 s: 200 samples are missing (67 %) in 1 gap, the longest of 2 s"
    )
    (column,) = open_signals(tmp_path / "b.csv").load(("force",))
    np.testing.assert_allclose(column.values[250:], np.arange(50, 100) % 9, atol=1e-9)
    path.write_text("\n".join(["t [s],force [N]", *rows[50:], *rows[:50]]), encoding="utf-8")
    first, second, _ = convert_file(path, tmp_path / "c.csv")
    assert '"t [s]": was set back by 3 after row 50 (line 51); the samples after it' in first
    assert second.endswith("force, N, 100 Hz, 1 s: no sample is missing")
    falling = "".join(f"{-t_s},{n % 9}\n" for n, t_s in enumerate(times_s))
    path.write_text(f"t [s],force [N]\n{falling}", encoding="utf-8")
    with pytest.raises(SourceError, match="add a column of times that never fall"):
        list(convert_file(path, tmp_path / "d.csv"))


def test_signals_of_several_rates_keep_them_or_are_interpolated_aloud(tmp_path: Path) -> None:
    wfdb_record(tmp_path, {"ABP": SIGNALS["RESP"][::2] * 10}, rate="125")
    wfdb_record(tmp_path, {"II": SIGNALS["II"]}, name="e")
    (tmp_path / "both.hea").write_text(
        "both 2 125\nrec.dat 16 100/mmHg 16 0 0 0 0 ABP\ne.dat 16x2 2000/mV 16 0 0 0 0 II\n",
        encoding="utf-8",
    )
    for suffix in ("edf", "xdf"):
        list(convert_file(tmp_path / "both", tmp_path / f"b.{suffix}"))
        rates = [signal.rate_hz for signal in open_signals(tmp_path / f"b.{suffix}").signals]
        assert rates == [125, 250]
    *_, last = convert_file(tmp_path / "both", tmp_path / "b.csv")
    assert last.endswith("interpolated at 250 Hz: ABP")


def test_our_recording_is_played_and_exported_to_each_format(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    about = {"subject": "S01", "position": "cun", "side": "left"}
    record(path, 3, {100, *range(300, 320)}, about=about)
    file = open_signals(path)
    assert [(s.name, s.unit, s.rate_hz) for s in file.signals] == [("pulse", "N", 1000.0)]
    (pulse,) = file.load((0,))
    assert find_gaps(pulse.values) == (105, 2, 100)
    for suffix in (".edf", ".hea", ".xdf"):
        line = export_signals(path, tmp_path / f"out{suffix}", suffix)
        assert "3 s at 1000 Hz, 2 losses" in line
        out = open_signals(tmp_path / f"out{suffix}")
        assert [(s.name, s.unit) for s in out.signals] == [
            ("Force pulse", "mN"),
            ("Force felt", "mN"),
        ]
        assert out.metadata == about
        (wrist,) = out.load(("Force pulse",))
        known = ~np.isnan(pulse.values)
        np.testing.assert_allclose(
            wrist.values[: len(known)][known], 1e3 * pulse.values[known], atol=0.02
        )
        if suffix != ".hea":
            assert "100 samples lost" in [mark.text for mark in out.marks]


def _mcap(path: Path, messages: list[tuple[int, Any]], encoding: str = "json") -> Path:
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        schema = writer.register_schema("sensor", "jsonschema", b"{}")
        channel = writer.register_channel("/film", encoding, schema)
        for t_ns, content in messages:
            writer.add_message(channel, t_ns, json.dumps(content).encode(), t_ns)
        writer.finish()
    return path


def test_numbers_of_any_mcap_in_json_are_signals(tmp_path: Path) -> None:
    force_n = 0.3 + 0.1 * np.sin(np.arange(500) / 10)
    times_ns = [10**18 + n * 4_000_000 + (n > 300) * 10**9 for n in range(500)]
    content = [{"force_n": each, "raw": {"adc": 1}, "ok": True, "text": "x"} for each in force_n]
    path = _mcap(tmp_path / "a.mcap", list(zip(times_ns, content, strict=True)))
    file = open_signals(path)
    found = [(s.name, s.unit, round(s.rate_hz or 0, 3)) for s in file.signals]
    assert found == [("/film.force_n", "N", 250.0), ("/film.raw.adc", "", 250.0)]
    (column,) = file.load(("/film.force_n",))
    assert (file.begin_ns, find_gaps(column.values).runs) == (10**18, 1)
    np.testing.assert_allclose(column.values[:300], force_n[:300], atol=1e-9)
    with pytest.raises(SourceError, match=r"only messages in JSON are read, not /film \(cdr\)"):
        open_signals(_mcap(tmp_path / "b.mcap", [(1, {"x": 1})], "cdr"))


def test_xdf_of_an_interrupted_stream_has_a_gap_and_markers(tmp_path: Path) -> None:
    path = tmp_path / "a.npz"
    np.savez(path, **{"rate_hz": 250.0, "force [N]": SIGNALS["RESP"]})
    list(convert_file(path, tmp_path / "a.xdf"))
    data = (tmp_path / "a.xdf").read_bytes()
    (tmp_path / "cut.xdf").write_bytes(data[: len(data) // 2])
    with pytest.raises(SourceError):
        open_signals(tmp_path / "cut.xdf")
    (tmp_path / "no_end.xdf").write_bytes(data[: data.rindex(b"<info><first_timestamp>") - 11])
    assert open_signals(tmp_path / "no_end.xdf").notes[0].endswith("no end: the file breaks off")


@pytest.mark.parametrize("suffix", ["edf", "xdf", "parquet", "npz", "csv", "mcap"])
def test_a_damaged_file_is_read_or_refused_in_one_line(
    source: Path, tmp_path: Path, suffix: str
) -> None:
    path = tmp_path / f"a.{suffix}"
    if suffix == "mcap":
        _mcap(path, [(n * 4_000_000, {"x": n % 7}) for n in range(500)])
    else:
        list(convert_file(source, path))
    data, rng = path.read_bytes(), np.random.default_rng(1)
    lines = []
    for number in range(60):
        damaged = bytearray(data)
        if number % 2:
            del damaged[rng.integers(len(data)) :]
        else:
            for at in rng.integers(len(data), size=3):
                damaged[at] ^= int(rng.integers(1, 256))
        path.write_bytes(damaged)
        try:
            file = open_signals(path)
            file.load([signal.number for signal in file.signals])
        except SourceError as error:
            lines.append(str(error))
    assert all(line.startswith(str(path)) and "\n" not in line for line in lines)


def test_what_cannot_be_converted_is_one_line(source: Path, tmp_path: Path) -> None:
    def refusal(source: Path, out: str) -> str:
        with pytest.raises((SourceError, OutputError)) as caught:
            list(convert_file(source, tmp_path / out))
        return str(caught.value)

    assert refusal(source, "rec.hea").endswith("exists already; name another file")
    assert "mp3 is none of .csv, .npz, .hea, .edf" in refusal(source, "a.mp3")
    assert "a record's name has letters, digits, _ and -" in refusal(source, "a b.hea")
    # `export` takes a path without a suffix, or with another one.
    file = open_signals(source)
    table = SignalTable(file.signals, [each.values for each in file.load((0, 1, 2))])
    write_signals(tmp_path / "plain", table, ".hea")
    assert len(open_signals(tmp_path / "plain").signals) == 3
    with pytest.raises(OutputError, match=r"digits, _ and -, not 'plain\.x'"):
        write_signals(tmp_path / "plain.x", table, ".hea")
    np.save(tmp_path / "a.npy", SIGNALS["II"])
    assert "states no rate; add a column of times" in refusal(tmp_path / "a.npy", "a.csv")
