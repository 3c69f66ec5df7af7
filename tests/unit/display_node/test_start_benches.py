"""The start of several drives, one after another."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from unittest.mock import Mock

import pytest

from display_node import benches
from tests.support.sender import display_scene


def test_samples_that_came_while_further_drives_were_homed_are_read_before_the_first_tick(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    happened: list[str] = []

    @contextmanager
    def start(*_: object) -> Iterator[Mock]:
        happened.append("started")
        yield Mock(**{"read.side_effect": lambda: happened.append("read")})

    monkeypatch.setattr(benches, "_start_bench", start)
    with benches.start_benches(display_scene("three_fingers_bench"), Path()) as started:
        assert len(started) == 3
        assert happened == ["started"] * 3 + ["read"] * 3
