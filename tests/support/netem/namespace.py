"""Network namespaces with TUN devices, whose packets a program reads and writes.

A namespace has no name, and the kernel removes it when no process or descriptor uses it. Requests
and flags are those of <linux/if_tun.h>, <linux/if.h> and <linux/sockios.h>.
"""

import ctypes
import os
import socket
import struct
import sys
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from functools import cache

from protocol.errors import TelepulseError

TUN_PATH = "/dev/net/tun"
MTU_BYTES = 1500
_TUNSETIFF = 0x400454CA
_IFF_TUN, _IFF_NO_PI = 0x0001, 0x1000
_IFF_UP, _IFF_RUNNING = 0x0001, 0x0040
_SIOCSIFFLAGS, _SIOCSIFADDR, _SIOCSIFNETMASK, _SIOCSIFMTU = 0x8914, 0x8916, 0x891C, 0x8922
_NETMASK = "255.255.255.252"


def open_tun(name: str, address: str) -> int:
    """Make a TUN device for IPv4 in the present network namespace, and bring it up.

    address: address of the device, in a network of four addresses. Returns a non-blocking
    descriptor for its packets; closing it removes the device. Raises OSError.
    """
    descriptor = os.open(TUN_PATH, os.O_RDWR | os.O_NONBLOCK | os.O_CLOEXEC)
    try:
        flags = _IFF_TUN | _IFF_NO_PI
        _control(descriptor, _TUNSETIFF, struct.pack("16sH14x", name.encode(), flags))
        _set(name, _SIOCSIFADDR, _internet(address))
        _set(name, _SIOCSIFNETMASK, _internet(_NETMASK))
        _set(name, _SIOCSIFMTU, struct.pack("i", MTU_BYTES))
        bring_up(name)
    except OSError:
        os.close(descriptor)
        raise
    return descriptor


def bring_up(name: str) -> None:
    """Bring an interface of the present network namespace up. Raises OSError."""
    _set(name, _SIOCSIFFLAGS, struct.pack("h", _IFF_UP | _IFF_RUNNING))


def _set(name: str, request: int, value: bytes) -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as control:
        _control(control.fileno(), request, struct.pack("16s24s", name.encode(), value))


def _control(descriptor: int, request: int, argument: bytes) -> None:
    # Windows has no such module; the tests that need a link are skipped there.
    import fcntl

    fcntl.ioctl(descriptor, request, argument)


def _internet(address: str) -> bytes:
    """Return a struct sockaddr_in without a port."""
    return struct.pack("=HH4s8x", socket.AF_INET, 0, socket.inet_aton(address))


_CLONE_NEWNET = 0x40000000
_OURS = "/proc/thread-self/ns/net"


@cache
def _libc() -> ctypes.CDLL:
    return ctypes.CDLL(None, use_errno=True)


class EmulatorError(TelepulseError, OSError):
    """The link emulator cannot run here, or its forwarder failed.

    Example scenarios: not root, no /dev/net/tun, the forwarder was killed.
    """


def unavailable() -> str | None:
    """Return why namespaces and TUN devices cannot be made here; None when they can."""
    if sys.platform != "linux":
        return "the link emulator needs Linux"
    if os.geteuid() != 0:
        return "the link emulator needs root"
    try:
        os.close(os.open(TUN_PATH, os.O_RDWR))
        with _back_afterwards():
            _check(_libc().unshare(_CLONE_NEWNET))
    except OSError as error:
        return f"the link emulator needs {TUN_PATH} and network namespaces: {error.strerror}"
    return None


class Namespace:
    """A network namespace with a loopback and a TUN device at each of `addresses`.

    descriptor: that of the namespace. tuns: those of the devices. Raises EmulatorError.
    """

    def __init__(self, addresses: Sequence[str]) -> None:
        self.addresses = tuple(addresses)
        self._descriptors = ExitStack()
        try:
            with _back_afterwards():
                _check(_libc().unshare(_CLONE_NEWNET))
                self.descriptor = self._kept(os.open(_OURS, os.O_RDONLY))
                bring_up("lo")
                self.tuns = tuple(
                    self._kept(open_tun(f"tun{number}", address))
                    for number, address in enumerate(addresses)
                )
        except OSError as error:
            self.close()
            raise EmulatorError(f"cannot make a namespace with TUN devices: {error}") from None

    @property
    def address(self) -> str:
        """Its first address."""
        return self.addresses[0]

    def close(self) -> None:
        """Release the namespace; the kernel removes it once no program runs in it."""
        self._descriptors.close()

    def _kept(self, descriptor: int) -> int:
        self._descriptors.callback(os.close, descriptor)
        return descriptor

    @contextmanager
    def entered(self) -> Iterator[None]:
        """Enter the namespace; sockets and programs opened inside stay there."""
        with _back_afterwards():
            _check(_libc().setns(self.descriptor, _CLONE_NEWNET))
            yield


@contextmanager
def _back_afterwards() -> Iterator[None]:
    """Return this thread to its present namespace at the end of the context."""
    home = os.open(_OURS, os.O_RDONLY)
    try:
        yield
    finally:
        _check(_libc().setns(home, _CLONE_NEWNET))
        os.close(home)


def _check(outcome: int) -> None:
    if outcome:
        number = ctypes.get_errno()
        raise OSError(number, os.strerror(number))
