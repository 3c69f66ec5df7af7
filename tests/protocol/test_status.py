import msgpack
import pytest

from protocol.errors import WireError
from protocol.status import pack_status, read_status
from protocol.summary import Samples, Summary

SUMMARY = Summary(samples=Samples(sent=5))


def test_a_sensing_nodes_status_comes_through() -> None:
    status = read_status(pack_status("streaming", "pulse", SUMMARY, False, 2**62, displays=3))
    assert (status.state, status.stream, status.final) == ("streaming", "pulse", False)
    assert (status.session, status.displays) == (2**62, 3)
    assert status.summary == SUMMARY.to_dict()


@pytest.mark.parametrize("more", [[1], [1, 2, 3], ["1", 2], [1, 2.0], [True, 1], [{}, []]])
def test_what_is_no_session_or_no_count_is_refused(more: list[object]) -> None:
    with pytest.raises(WireError):
        read_status(msgpack.packb(["playing", "pulse", {}, False, *more]))
