"""A network namespace of our own, nameless: it goes when nothing holds it any more."""

import ctypes
import os
import subprocess
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from typing import IO

from protocol.errors import TelepulseError
from telepulse.emulator.tun import TUN_PATH, bring_up, open_tun

_CLONE_NEWNET = 0x40000000
_OURS = "/proc/thread-self/ns/net"
_libc = ctypes.CDLL(None, use_errno=True)


class EmulatorError(TelepulseError, OSError):
    """The link emulator cannot run here, or its relay failed.

    Example scenarios: not root, no /dev/net/tun, the relay was killed.
    """


def unavailable() -> str | None:
    """Why namespaces and TUN devices cannot be made here; None when they can."""
    if os.geteuid() != 0:
        return "the link emulator needs root"
    try:
        os.close(os.open(TUN_PATH, os.O_RDWR))
        with _and_home_again():
            _unshare()
    except OSError as error:
        return f"the link emulator needs {TUN_PATH} and network namespaces: {error.strerror}"
    return None


class Namespace:
    """A network namespace with a loopback and a TUN device at each of `addresses`.

    tuns: the descriptors their packets are read from and written to.
    """

    def __init__(self, addresses: Sequence[str]) -> None:
        """Raises EmulatorError."""
        self.addresses = tuple(addresses)
        self._descriptors = ExitStack()
        try:
            with _and_home_again():
                _unshare()
                self._namespace = self._kept(os.open(_OURS, os.O_RDONLY))
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
        """Let go of it; the kernel removes it once no program runs in it any more."""
        self._descriptors.close()

    def _kept(self, descriptor: int) -> int:
        self._descriptors.callback(os.close, descriptor)
        return descriptor

    @contextmanager
    def entered(self) -> Iterator[None]:
        """Within, what this thread opens or starts is in the namespace, and stays there."""
        with _and_home_again():
            _check(_libc.setns(self._namespace, _CLONE_NEWNET))
            yield

    def start(
        self,
        *command: str,
        stdout: IO[str] | int | None = None,
        stderr: IO[str] | int | None = None,
    ) -> subprocess.Popen[str]:
        """Start a program in the namespace; it is the caller's to end."""
        with self.entered():
            return subprocess.Popen(command, stdout=stdout, stderr=stderr, text=True)


@contextmanager
def _and_home_again() -> Iterator[None]:
    """Afterwards this thread is in the namespace that it was in before."""
    home = os.open(_OURS, os.O_RDONLY)
    try:
        yield
    finally:
        _check(_libc.setns(home, _CLONE_NEWNET))
        os.close(home)


def _unshare() -> None:
    _check(_libc.unshare(_CLONE_NEWNET))


def _check(outcome: int) -> None:
    if outcome:
        number = ctypes.get_errno()
        raise OSError(number, os.strerror(number))
