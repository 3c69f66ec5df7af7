import msgpack
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from protocol.errors import WireError
from protocol.wire.marks import (
    MOST_CHARACTERS,
    Mark,
    MarkRequest,
    pack_mark,
    pack_request,
    printable,
    read_mark,
    read_request,
)

IDS = st.integers(0, (1 << 62) - 1)
TIMES_NS = st.integers(-(1 << 62), (1 << 62) - 1)


@given(IDS, st.none() | TIMES_NS, st.text())
@example(1, None, "\U0001f44b" * 300)
def test_a_request_comes_back_with_its_text_in_one_printable_line(
    id: int, at_ns: int | None, text: str
) -> None:
    packed = pack_request(MarkRequest(id, at_ns, text))
    # The display's socket closes the connection of a longer message.
    assert len(packed) <= 1_024
    request = read_request(packed)
    assert request == MarkRequest(id, at_ns, printable(text))
    assert len(request.text) <= MOST_CHARACTERS
    assert request.text.isprintable()


@given(IDS, TIMES_NS, st.text().map(printable))
def test_a_mark_comes_back(id: int, at_ns: int, text: str) -> None:
    assert read_mark(pack_mark(Mark(3, id, at_ns, text))) == Mark(3, id, at_ns, text)


@pytest.mark.parametrize(
    "fields",
    [
        [],
        [1, None, "text", 4],
        [1.5, None, "text"],
        [True, None, "text"],
        [1, 1 << 62, "text"],
        [1, None, b"text"],
        [1, None, "a\nb"],
        [1, None, "a" * 201],
        {"id": 1},
    ],
)
def test_a_request_that_is_none_is_refused(fields: object) -> None:
    with pytest.raises(WireError):
        read_request(b"\2" + msgpack.packb(fields))
