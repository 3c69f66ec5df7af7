"""TUN devices: a network interface whose packets a program reads and writes.

Requests and flags are those of <linux/if_tun.h>, <linux/if.h> and <linux/sockios.h>.
"""

import fcntl
import os
import socket
import struct

TUN_PATH = "/dev/net/tun"
MTU_BYTES = 1500
_TUNSETIFF = 0x400454CA
_IFF_TUN, _IFF_NO_PI = 0x0001, 0x1000
_IFF_UP, _IFF_RUNNING = 0x0001, 0x0040
_SIOCSIFFLAGS, _SIOCSIFADDR, _SIOCSIFNETMASK, _SIOCSIFMTU = 0x8914, 0x8916, 0x891C, 0x8922
_NETMASK = "255.255.255.252"


def open_tun(name: str, address: str) -> int:
    """Make a TUN device in the present network namespace and bring it up; IPv4 packets only.

    address: its own, in a network of four. Returns the non-blocking descriptor to read and write
    packets with; the device goes when it is closed. Raises OSError.
    """
    descriptor = os.open(TUN_PATH, os.O_RDWR | os.O_NONBLOCK | os.O_CLOEXEC)
    try:
        flags = _IFF_TUN | _IFF_NO_PI
        fcntl.ioctl(descriptor, _TUNSETIFF, struct.pack("16sH14x", name.encode(), flags))
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as control:
            _request(control, _SIOCSIFADDR, name, _internet(address))
            _request(control, _SIOCSIFNETMASK, name, _internet(_NETMASK))
            _request(control, _SIOCSIFMTU, name, struct.pack("i", MTU_BYTES))
        bring_up(name)
    except OSError:
        os.close(descriptor)
        raise
    return descriptor


def bring_up(name: str) -> None:
    """Bring an interface of the present network namespace up. Raises OSError."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as control:
        _request(control, _SIOCSIFFLAGS, name, struct.pack("h", _IFF_UP | _IFF_RUNNING))


def _request(control: socket.socket, number: int, name: str, value: bytes) -> None:
    fcntl.ioctl(control, number, struct.pack("16s24s", name.encode(), value))


def _internet(address: str) -> bytes:
    """A struct sockaddr_in without a port."""
    return struct.pack("=HH4s8x", socket.AF_INET, 0, socket.inet_aton(address))
