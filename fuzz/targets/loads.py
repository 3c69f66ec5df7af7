"""Tables of reference loads, for a calibration."""

from contextlib import suppress

import numpy as np

from fuzz.targets import scratch_folder
from protocol.errors import SourceError
from telepulse.commissioning.calibration import read_loads

_FILE = scratch_folder() / "loads.csv"


def seeds() -> list[bytes]:
    """Return tables with and without a header, units and comments."""
    return [
        b"0,0\n1,44\n2,88\n",
        b"# a film\nload (kg), reading_mV\n0.1,44\n\n0.2,88\n",
        b'weight [g];\n"counts","mass_kg"\n1,2\n',
    ]


def try_one(data: bytes) -> None:
    """Read a file: it is refused, or has finite numbers."""
    _FILE.write_bytes(data)
    with suppress(SourceError):
        loads = read_loads(_FILE, None, None)
        assert np.isfinite(loads.load_n).all()
        assert np.isfinite(loads.reading).all()
