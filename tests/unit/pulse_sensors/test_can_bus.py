import math
import struct
from pathlib import Path

import can
import pytest

from protocol.errors import SourceError
from pulse_sensors.can_bus import CanDecoder
from tests.support.can_messages import can_scene, film_message, write_database
from tests.support.refusals import refusal_of
from tests.support.sample_blocks import Decoded, plain


@pytest.fixture(autouse=True)
def folder(tmp_path: Path) -> Path:
    write_database(tmp_path)
    return tmp_path


def message(identifier: int, data: bytes, at_s: float = 1.0) -> can.Message:
    return can.Message(at_s, arbitration_id=identifier, is_extended_id=False, data=data)


def test_the_counter_reveals_losses_and_wraps(folder: Path) -> None:
    decoder = CanDecoder(can_scene(counter="Count"), folder)
    numbers = [*range(250, 262), *range(270, 275)]
    blocks = plain(block for number in numbers for block in decoder.feed(film_message(number)))
    assert [block.missing for block in blocks] == [0] * 12 + [8] + [0] * 4
    assert blocks[0].restarted
    assert blocks[1] == Decoded((0.25,), round((1e9 + 0.251) * 1e9))
    assert not decoder.rejected
    # The counter jumps without the time.
    assert decoder.feed(film_message(475, at_s=1e9 + 0.275))[0].missing == 0
    assert decoder.rejected == {"counter": 1}


SINGLE = {"signal": "Single", "counter": "Tick"}


@pytest.mark.parametrize(
    ("keys", "received", "cause"),
    [
        *(({}, message(291, bytes(length)), "not_decoded") for length in range(4)),
        (SINGLE, message(295, struct.pack("<ff", math.nan, 0)), "not_finite"),
        (SINGLE, message(295, struct.pack("<ff", 1e31, 0)), "not_finite"),
        (SINGLE, message(295, struct.pack("<ff", 0, math.nan)), "not_decoded"),
        ({}, can.Message(is_error_frame=True), "bus_error"),
    ],
)
def test_a_message_without_a_sample_is_counted(
    folder: Path, keys: dict[str, object], received: can.Message, cause: str
) -> None:
    decoder = CanDecoder(can_scene(**keys), folder)
    assert decoder.feed(received) == []
    assert decoder.rejected == {cause: 1}


def test_a_multiplexed_message_with_another_signal_is_ignored(folder: Path) -> None:
    decoder = CanDecoder(can_scene(signal="Squeeze"), folder)
    pages = [message(294, bytes([page, 100, 0]), 1.0 + page) for page in (0, 1)]
    blocks = plain(block for page in pages for block in decoder.feed(page))
    assert [block.values for block in blocks] == [(0.01,)]
    assert not decoder.rejected


@pytest.mark.parametrize(
    ("keys", "text"),
    [
        ({"signal": "Pulse"}, "no signal 'Pulse'; it has Force, Count, Temperature, Page, Squeeze"),
        ({"unit": "mN"}, '\'Force\' is in N, the scene says unit = "mN"; set unit = "N"'),
        ({"unit": "V"}, '\'Force\' is in N, the scene says unit = "V"; set unit = "N"'),
        ({"counter": "Tick"}, "Film has no signal 'Tick'; it has Force, Count"),
        ({"message": "Fil"}, "no message 'Fil'; it has Film, Other, Paged, Floating, Twin"),
        ({"signal": "Temperature"}, "'Temperature' is in Other, Twin; say which: message"),
        ({"database": "none.dbc"}, "no such database"),
        ({"database": "bad.dbc"}, "cannot be read: "),
    ],
)
def test_an_unfit_database_is_refused_in_one_line(
    folder: Path, keys: dict[str, object], text: str
) -> None:
    (folder / "bad.dbc").write_bytes(b"\xff\x00 no database")
    line = refusal_of(SourceError, CanDecoder, can_scene(**keys), folder)
    assert text in line
    assert line.startswith(str(folder))
