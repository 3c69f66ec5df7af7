"""Free addresses: whose ports nobody holds, nor was just given."""

from socket import AF_INET, SOCK_STREAM, socket
from urllib.parse import urlsplit

from telepulse.processes import HOST, free_addresses


def test_no_port_is_given_twice_in_a_row_though_nobody_binds_it() -> None:
    # By chance alone, 500 of 8500 would be different ones in one run of a million.
    given = [address for _ in range(500) for address in free_addresses(1)]
    assert len(set(given)) == len(given)


def test_the_port_and_the_next_can_be_bound() -> None:
    for address in free_addresses(3):
        port = urlsplit(address).port
        assert port is not None
        with socket(AF_INET, SOCK_STREAM) as data, socket(AF_INET, SOCK_STREAM) as control:
            data.bind((HOST, port))
            control.bind((HOST, port + 1))
