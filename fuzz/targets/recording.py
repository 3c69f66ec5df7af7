"""Recordings as sources: the first byte chooses the kind of file and how it is read."""

import io
from contextlib import suppress

import numpy as np
from mcap.writer import Writer
from scipy.io import wavfile

from fuzz.targets import scratch_folder
from protocol.config.scene import validate
from protocol.errors import SourceError
from sensing_node.sources.recorded import RecordedSource, RecordingScene
from telepulse.recording import edf_writer, xdf_writer
from telepulse.recording.signal_table import SignalTable

_FOLDER = scratch_folder()
_TABLES = (
    {"unit": "N", "column": 0},
    {"unit": "mV", "column": "force", "film_radius": "4 mm"},
    {"unit": "raw", "column": 1, "peak_to_peak": "0.3 N"},
)
_SCENES = [
    validate(
        {"kind": "recording", "path": f"pulse.{suffix}", "rate": "100 Hz"} | table,
        RecordingScene,
        where="fuzz",
    )
    for suffix in ("csv", "npy", "npz", "edf", "wav", "xdf", "mcap")
    for table in _TABLES
]


def seeds() -> list[bytes]:
    """Return one file of each kind, read in each way, and some that cannot be scaled or sent."""
    table = np.array([[0.1, 1], [0.2, 2], [0.3, 4]], "<f4")
    npy, npz = io.BytesIO(), io.BytesIO()
    np.save(npy, table)
    np.savez(npz, force=table[:, 0], more=table[:, 1])
    csv = b"time,force\n0,0.1\n1,0.2\n2,0.3\n"
    files = [csv, npy.getvalue(), npz.getvalue()]
    values = np.stack([np.arange(200.0) % 80, np.arange(200.0) % 70], axis=1)
    pulse = SignalTable(["force", "more"], ["mV", "mV"], values, 100, 10**18)
    for write in (
        lambda path: edf_writer.write(path, pulse),
        lambda path: wavfile.write(path, 100, values.astype(np.float32)),
        lambda path: xdf_writer.write(path, pulse),
    ):
        path = _FOLDER / "seed"
        path.unlink(missing_ok=True)
        write(path)
        files.append(path.read_bytes())
    mcap = io.BytesIO()
    writer = Writer(mcap)
    writer.start()
    channel = writer.register_channel("force", "json", 0)
    for number in range(200):
        data = b'{"n": %d}' % (number % 80)
        writer.add_message(channel, number * 10_000_000, data, number * 10_000_000)
    writer.finish()  # type: ignore[no-untyped-call]
    files.append(mcap.getvalue())
    plain = [bytes([number]) + files[number // len(_TABLES)] for number in range(len(_SCENES))]
    rows = [b"2016-11-24 13:58:%02d,%d,%g" % (at, at % 5, 0.01 * at) for at in range(20)]
    timed = b"time,force,t_ms\n" + b"\n".join(rows)
    odd = (
        b"\0" + timed,
        b"\1" + timed,
        b"\2" + timed,
        b"\0" + csv + b"nan,0\n",
        b"\0" + csv + b"1e300,0\n",
        b"\2a,b\n0,0\n0,5e-324\n",
    )
    return [*plain, *odd]


def try_one(data: bytes) -> None:
    """Read a file: it is refused, or has samples that a frame can carry."""
    if data:
        scene = _SCENES[data[0] % len(_SCENES)]
        (_FOLDER / scene.path).write_bytes(data[1:])
        with suppress(SourceError):
            assert np.isfinite(RecordedSource(scene, _FOLDER).take(10).astype("<f4")).all()
