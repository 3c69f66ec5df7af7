import pytest
import zmq

from protocol import sockets
from protocol.errors import AddressError
from protocol.sockets import Context


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


@pytest.mark.parametrize(
    "address",
    [
        "",
        "127.0.0.1:5555",
        "tcp://",
        "tcp://127.0.0.1",
        "tcp://127.0.0.1:",
        "tcp://127.0.0.1:*",
        "tcp://127.0.0.1:0",
        "tcp://127.0.0.1:65535",
        "tcp://127.0.0.1:99999",
        "tcp://127.0.0.1:-1",
        "tcp://127.0.0.1:5555/x",
        "tcp://two words:5555",
        "udp://127.0.0.1:5555",
        "inproc://x",
        "ipc://",
    ],
)
def test_what_is_no_address_of_a_stream_is_told_what_is_one(address: str) -> None:
    with pytest.raises(AddressError) as caught:
        sockets.control_address(address)
    assert str(caught.value).startswith(f"{address}: not an address; write tcp://HOST:PORT")


@pytest.mark.parametrize(
    ("address", "beyond"),
    [
        ("tcp://127.0.0.1:5555", False),
        ("tcp://127.1.2.3:5555", False),
        ("tcp://localhost:5555", False),
        ("tcp://[::1]:5555", False),
        ("tcp://127.0.0.1:*", False),
        ("ipc:///tmp/pulse", False),
        ("inproc://pulse", False),
        ("tcp://*:5555", True),
        ("tcp://*:*", True),
        ("tcp://0.0.0.0:5555", True),
        ("tcp://0.0.0.0:*", True),
        ("tcp://[::]:5555", True),
        ("tcp://eth0:5555", True),
        ("tcp://192.168.1.7:5555", True),
        ("tcp://sensing.example:5555", True),
        ("tcp://127.0.0.1.example:5555", True),
        ("tcp://localhost.example:5555", True),
        ("tcp://10.127.0.1:5555", True),
    ],
)
def test_which_addresses_reach_beyond_this_machine(address: str, beyond: bool) -> None:
    assert sockets.beyond_loopback(address) is beyond


def test_a_taken_port_is_one_line_with_address_and_cause(context: Context) -> None:
    first = sockets.bind(context, zmq.PUB, "tcp://127.0.0.1:*")
    address = first.getsockopt_string(zmq.LAST_ENDPOINT)
    with pytest.raises(AddressError) as caught:
        sockets.bind(context, zmq.PUB, address)
    line = str(caught.value)
    assert line == f"cannot bind {address}: Address already in use; another program holds it"


@pytest.mark.parametrize(
    ("address", "cause"),
    [
        ("nonsense", "Invalid argument"),
        ("tcp://127.0.0.1", "Invalid argument"),
        ("udp://127.0.0.1:5555", "protocol"),
        ("tcp://192.0.2.1:5555", "this machine does not have it"),
        ("tcp://no-such-interface:5555", "this machine does not have it"),
        ("ipc:///no/such/folder/pulse", "No such file or directory"),
        ("ipc://" + "x" * 200, "File name too long"),
        ("tcp://127.0.0.1:65536", "no such port"),
        ("tcp://127.0.0.1:99999", "no such port"),
    ],
)
def test_an_address_that_cannot_be_bound(context: Context, address: str, cause: str) -> None:
    with pytest.raises(AddressError, match=cause) as caught:
        sockets.bind(context, zmq.PUB, address)
    assert address in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    "address", ["nonsense", "tcp://", "tcp://127.0.0.1", "udp://127.0.0.1:5", "tcp://h:99999"]
)
def test_an_address_that_cannot_be_connected(context: Context, address: str) -> None:
    with pytest.raises(AddressError, match=address) as caught:
        sockets.connect(context, zmq.SUB, address)
    assert "\n" not in str(caught.value)
