"""Marks from a stream of LSL."""

from pathlib import Path

import pytest

from protocol.errors import SourceError
from telepulse.recording import marks
from telepulse.recording.marks import LslMarks, TakenMark
from tests.support.lsl_loopback import lsl_on_loopback
from tests.support.waiting import until


def test_texts_of_a_stream_are_marks_with_their_age(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pylsl = lsl_on_loopback(tmp_path, monkeypatch)
    monkeypatch.setattr(marks, "RESOLVE_S", 10.0)
    numbers = pylsl.StreamInfo("telepulse numbers", "x", 1, 0, pylsl.cf_float32, "numbers")
    texts = pylsl.StreamInfo("telepulse stimuli", "Markers", 1, 0, pylsl.cf_string, "stimuli")
    outlets = [pylsl.StreamOutlet(numbers), pylsl.StreamOutlet(texts)]
    with pytest.raises(SourceError, match="has numbers, and a mark is a text"):
        LslMarks("telepulse numbers")
    source = LslMarks("telepulse stimuli")
    until(outlets[1].have_consumers)
    outlets[1].push_sample(["tone\n on"], pylsl.local_clock() - 0.5)
    found: list[TakenMark] = []
    until(lambda: bool(found.extend(source.take()) or found))
    assert found[0].text == "tone  on"
    assert 0.49e9 < found[0].age_ns < 10e9
    monkeypatch.setattr(marks, "RESOLVE_S", 0.1)
    with pytest.raises(SourceError, match="not found within"):
        LslMarks("nobody")
