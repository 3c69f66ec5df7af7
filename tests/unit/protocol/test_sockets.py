import pytest
from hypothesis import given
from hypothesis import strategies as st

from protocol import sockets
from protocol.errors import AddressError

HERE = [
    *("tcp://127.0.0.1:5555", "tcp://127.1.2.3:5555", "tcp://localhost:5555", "tcp://[::1]:5555"),
    *("tcp://127.0.0.1:*", "ipc:///tmp/pulse", "inproc://pulse"),
]
BEYOND = [
    *("tcp://*:5555", "tcp://*:*", "tcp://0.0.0.0:5555", "tcp://0.0.0.0:*", "tcp://[::]:5555"),
    *("tcp://eth0:5555", "tcp://192.168.1.7:5555", "tcp://sensing.example:5555"),
    *("tcp://127.0.0.1.example:5555", "tcp://localhost.example:5555", "tcp://10.127.0.1:5555"),
]
NO_ADDRESSES = [
    *("", "127.0.0.1:5555", "tcp://", "tcp://127.0.0.1", "tcp://127.0.0.1:", "tcp://127.0.0.1:*"),
    *("tcp://127.0.0.1:0", "tcp://127.0.0.1:65535", "tcp://127.0.0.1:99999", "tcp://127.0.0.1:-1"),
    *("tcp://127.0.0.1:5555/x", "tcp://two words:5555", "udp://127.0.0.1:5555", "inproc://x"),
    "ipc://",
]


@pytest.mark.parametrize(
    ("address", "control"),
    [
        ("tcp://127.0.0.1:5555", "tcp://127.0.0.1:5556"),
        ("tcp://*:1", "tcp://*:2"),
        ("tcp://sensing.example:65534", "tcp://sensing.example:65535"),
        ("tcp://[::1]:5555", "tcp://[::1]:5556"),
        ("ipc:///tmp/pulse", "ipc:///tmp/pulse.control"),
        ("ipc://@abstract", "ipc://@abstract.control"),
    ],
)
def test_the_control_address_of_a_stream(address: str, control: str) -> None:
    assert sockets.control_address(address) == control


@pytest.mark.parametrize("address", NO_ADDRESSES)
def test_an_invalid_address_of_a_stream_is_refused_with_valid_ones(address: str) -> None:
    with pytest.raises(AddressError) as caught:
        sockets.control_address(address)
    assert str(caught.value).startswith(f"{address}: not an address; write tcp://HOST:PORT")


def test_addresses_beyond_this_machine_are_recognised() -> None:
    assert [address for address in HERE + BEYOND if sockets.beyond_loopback(address)] == BEYOND


WORDS = st.text(min_size=1)


@given(WORDS | WORDS.map("tcp://{}".format) | WORDS.map("tcp://127.0.0.1:{}".format))
def test_any_address_has_a_control_address_or_is_refused(address: str) -> None:
    sockets.beyond_loopback(address)
    try:
        control = sockets.control_address(address)
    except AddressError:
        return
    assert control.startswith(("tcp://", "ipc://"))
    assert control != address
