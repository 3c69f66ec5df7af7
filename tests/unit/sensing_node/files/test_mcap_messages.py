"""Numbers in messages of other programs: which field is played, and what is missing."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from protocol.errors import SourceError
from sensing_node.files.formats import open_signals
from sensing_node.files.grids import find_gaps
from sensing_node.files.signal_choice import record_table
from tests.support.signal_files import mcap

FORCE_N = (0.3 + 0.1 * np.sin(np.arange(500) / 10)).tolist()


def stamp(number: int) -> dict[str, int]:
    return {"sec": 5 + number // 250, "nsec": number % 250 * 4_000_000}


@pytest.mark.parametrize(
    ("topic", "content", "played"),
    [
        ("/pulse", lambda n, v: {"stamp": stamp(n), "seq": n, "force": v}, "/pulse.force"),
        ("/pulse", lambda n, v: {"header": {"stamp": stamp(n)}, "data": v}, "/pulse.data"),
        ("/pulse", lambda n, v: {"number": n, "value": v}, "/pulse.value"),
        ("/pulse", lambda n, v: {"t_ns": n, "other": v, "ppg": v}, "/pulse.ppg"),
        ("/realtime/film", lambda n, v: {"counter": n, "x": v}, "/realtime/film.x"),
        ("/film", lambda n, v: {"data": [v, 2.0]}, "/film.data[0]"),
        ("/film", lambda n, v: {"a": [{"force_n": v}, {"force_n": 0}]}, "/film.a[0].force_n"),
    ],
)
def test_the_field_with_the_pulse_is_played(
    tmp_path: Path, topic: str, content: Any, played: str
) -> None:
    path = mcap(tmp_path / "a.mcap", [content(n, v) for n, v in enumerate(FORCE_N)], topic)
    table, text = record_table(path)
    assert f"plays {played} (" in text
    (column,) = open_signals(path).load((table["column"],))
    np.testing.assert_allclose(column.values, FORCE_N)


def test_null_and_nan_are_missing_samples_at_the_rate_of_all_messages(tmp_path: Path) -> None:
    values = [None if n % 2 else v for n, v in enumerate(FORCE_N)]
    values[100:140] = [float("nan")] * 40
    contents = [{"f": v, "other": None, "big": 10**400, "text": "x"} for v in values]
    file = open_signals(mcap(tmp_path / "a.mcap", contents))
    assert [(each.name, each.rate_hz) for each in file.signals] == [("/pulse.f", 250.0)]
    (column,) = file.load((0,))
    assert find_gaps(column.values).samples == 250 + 20
    np.testing.assert_array_equal(column.values[:100:2], FORCE_N[:100:2])
    assert len(file.notes) == 2
    with pytest.raises(SourceError, match=r"signal '/pulse\.other' holds no number"):
        file.find("/pulse.other")


def test_messages_in_another_encoding_are_refused_by_name(tmp_path: Path) -> None:
    path = mcap(tmp_path / "a.mcap", [{"x": 1}], "/film", "cdr")
    with pytest.raises(SourceError, match=r"only messages in JSON are read, not /film \(cdr\)"):
        open_signals(path)
